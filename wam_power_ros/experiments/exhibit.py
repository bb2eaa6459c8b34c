# SPDX-License-Identifier: Apache-2.0
"""The answer of a simulated session once more, in this process: its paths, and a film of it.

A rollout is a function of the session's seed and the policy with its id, so this is the very
rollout that the session ran. Rendering needs OpenGL; which library MuJoCo takes is decided by
MUJOCO_GL when it is first imported.
"""

from __future__ import annotations

import argparse
import copy
import sys
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from hardware_sim.world import QUIET, Truth, World
from wam_power_ros import figures, policy, report, session
from wam_power_ros.experiments.bench import Bench
from wam_power_ros.experiments.film import TRACE_RATE
from wam_power_ros.flight import observe_flight

FILM_RATE = 25.0  # [Hz], played at the speed of life
BACKGROUND = (246, 247, 249)


def render(
    world: World, poses: Sequence[np.ndarray], size: tuple[int, int] = (480, 480)
) -> list[np.ndarray]:
    """Pictures of arm and pancake.

    Args:
        world: Whose they are; its state is not touched.
        poses: Joint positions of arm and pancake, such as those of `World.trace`. Shapes (nq,).
        size: Width and height [pixel].

    Returns:
        RGB images. Shapes (h, w, 3), uint8.

    Raises:
        RuntimeError: There is no OpenGL, with the reason.
    """
    model = _lit(world.model, *size)
    try:
        renderer = mujoco.Renderer(model, size[1], size[0])
    except Exception as error:  # each OpenGL library has errors of its own
        raise RuntimeError(f"nothing to render with: {error}") from error
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (0.42, 0.0, 0.85)
    camera.distance, camera.azimuth, camera.elevation = 2.1, 105.0, -12.0
    data = mujoco.MjData(model)
    frames = []
    with renderer:
        for qpos in poses:
            data.qpos[:] = qpos
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            frame = renderer.render().copy()
            renderer.enable_segmentation_rendering()
            frame[renderer.render()[:, :, 0] < 0] = BACKGROUND  # nothing is there
            renderer.disable_segmentation_rendering()
            frames.append(frame)
    return frames


def _lit(model: mujoco.MjModel, width: int, height: int) -> mujoco.MjModel:
    """A copy for looking at: even light, a floor without end."""
    model = copy.copy(model)
    visual = model.vis
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.headlight.ambient[:], visual.headlight.diffuse[:] = 0.4, 0.35
    visual.headlight.specular[:] = 0.1
    visual.quality.shadowsize = 4096
    model.light_type[:] = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    model.light_diffuse[:] = 0.45
    model.geom_size[model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE, :2] = 0.0
    return model


def run(folder: Path, film: bool) -> report.Exhibit:
    """Execute the answer of a session again; with `film` write `film.webp` beside it.

    Raises:
        session.SessionError: No session there, or one without a policy yet.
        RuntimeError: There is no OpenGL for the film.
    """
    header, _, _ = session.read(folder)
    saved = folder / "policy.json"
    if not saved.exists():
        raise session.SessionError(f"{folder} holds no policy yet")
    answer = policy.from_json(saved.read_text())
    world = World(seed=header.seed)
    world.trace = []
    bench = Bench(world)
    calm = bench.run(policy.with_id(answer, f"answer{QUIET}"))
    sys.stdout.write(f"without noise the answer {_outcome(calm[2], calm[3])}\n")
    pan, pancake, truth, fault = bench.run(answer)
    flight = observe_flight(pan, pancake, header.settings.delta_h)
    caption = f"{_outcome(truth, fault)}."
    path = folder / "film.webp"
    if film:
        poses = world.trace[:: round(TRACE_RATE / FILM_RATE)]
        figures.save_film(render(world, poses), path, FILM_RATE)
    return report.Exhibit(
        caption=caption,
        pan=pan,
        pancake=pancake,
        t_f=flight.t_f,
        film=path.read_bytes() if film else None,
    )


def _outcome(truth: Truth, fault: str) -> str:
    return fault or (
        f"turned {abs(truth.angle_deg):.0f}° until it came down, "
        f"{'flipped' if truth.flipped else 'not flipped'} and "
        f"{'caught' if truth.caught else 'dropped'}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `python -m wam_power_ros.experiments.exhibit`: writes a session's report."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("session", type=Path)
    parser.add_argument("--no-film", metavar="WHY", help="leave the film out, for this reason")
    options = parser.parse_args(arguments)
    exhibit = run(options.session, film=options.no_film is None)
    report.write(options.session, exhibit, options.no_film or "")
    return 0


if __name__ == "__main__":
    sys.exit(main())
