# SPDX-License-Identifier: Apache-2.0
"""The answer of a simulated session once more, in this process: its paths, and a film of it.

A rollout is a function of the session's seed and the policy with its id, so this is the very
rollout that the session ran. Rendering needs OpenGL; which library MuJoCo takes is decided by
MUJOCO_GL when it is first imported.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from hardware_sim.ground_truth import Truth
from hardware_sim.world import QUIET, World
from wam_power_ros.experiments.environment import Environment
from wam_power_ros.experiments.filmstrip import TRACE_RATE
from wam_power_ros.experiments.render import render
from wam_power_ros.learning import policy
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.practice import session
from wam_power_ros.reporting import figures, session_report
from wam_power_ros.tasks.flip.flight import observe_flight

FILM_RATE = 25.0  # [Hz], played at the speed of life


def run(folder: Path, film: bool) -> session_report.Exhibit:
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
    environment = Environment(world)
    noise_free = environment.run(policy.with_id(answer, f"answer{QUIET}"))
    sys.stdout.write(f"without noise the answer {_outcome(*noise_free)}\n")
    rollout, truth = environment.run(answer)
    pan, pancake = rollout.tool, rollout.body
    flight = observe_flight(pan, pancake, header.settings.task_settings.delta_h)
    caption = f"{_outcome(rollout, truth)}."
    path = folder / "film.webp"
    if film:
        poses = world.trace[:: round(TRACE_RATE / FILM_RATE)]
        figures.save_film(render(world, poses), path, FILM_RATE)
    return session_report.Exhibit(
        caption=caption,
        pan=pan,
        pancake=pancake,
        t_f=flight.t_f,
        film=path.read_bytes() if film else None,
    )


def _outcome(rollout: Rollout, truth: Truth) -> str:
    if rollout.fault is not None:
        return rollout.fault.text
    return (
        f"turned {abs(truth['angle_deg']):.0f}° until it came down, "
        f"{'flipped' if truth['flipped'] else 'not flipped'} and "
        f"{'caught' if truth['caught'] else 'dropped'}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """`python -m wam_power_ros.experiments.session_answer`: writes a session's report."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("session", type=Path)
    parser.add_argument("--no-film", metavar="WHY", help="leave the film out, for this reason")
    options = parser.parse_args(arguments)
    exhibit = run(options.session, film=options.no_film is None)
    session_report.write(options.session, exhibit, options.no_film or "")
    return 0


if __name__ == "__main__":
    sys.exit(main())
