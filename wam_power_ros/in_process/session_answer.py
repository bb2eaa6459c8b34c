# SPDX-License-Identifier: Apache-2.0
"""Execute the final policy of a simulated session again, for paths and film of its report.

A rollout is a function of the session's seed and of the policy with its id, so this is exactly the
rollout that the session ran. Rendering needs OpenGL; MUJOCO_GL selects the library that MuJoCo
loads when it is first imported.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hardware_sim.ground_truth import Truth
from hardware_sim.world import QUIET, TRACE_RATE
from wam_power_ros import durable_files
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.in_process.render import render
from wam_power_ros.learning import policy
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.params import overlay
from wam_power_ros.practice import session
from wam_power_ros.reporting import figures, session_report
from wam_power_ros.tasks.task import Task

FILM_RATE = 25.0  # [Hz], real time
UNITS = {"t_f": " s", "angle_deg": "°", "apex": " m"}
WORDS = {"flipped": "turned over"}  # a flip is a true flip
ARM_TRUTH = ("peak_", "saturated")  # ground truth about the arm, left out of the caption


@dataclass(frozen=True)
class Outcome:
    """Outcome of an executed policy, a `tasks.task.LoggedRollout`."""

    ret: float | None
    observation: Mapping[str, Any] | None
    success: bool
    why: str
    fault: str
    truth: Truth
    kind: str = "retest"


def run(folder: Path, film: bool) -> session_report.ShownRollout:
    """Execute the final policy of a session; with `film`, write `film.webp` into its folder.

    Raises:
        ValueError: There is no session, it has no policy yet, or it does not say in which set-up it
            ran.
        RuntimeError: OpenGL, which the film needs, is missing.
    """
    found = session.read(folder)
    task = found.task
    saved = folder / "policy.json"
    if not saved.exists():
        raise ValueError(f"{folder} has no policy yet")
    answer = policy.from_json(saved.read_text())
    parameters = folder / "logs" / "parameters.yaml"
    if not parameters.exists():
        raise ValueError(f"{parameters}, the set-up of the session, is missing")
    setup = overlay.read(parameters).changed({"wam_sim": {"seed": found.header.seed}})
    environment = Environment.from_setup(setup)
    world = environment.world
    quiet = policy.with_id(answer, f"answer{QUIET}")
    without = _caption(task, quiet, *environment.run(quiet))
    rollout, truth = environment.run(answer)
    caption = f"{_caption(task, answer, rollout, truth)} Without noise: {without}"
    path = folder / "film.webp"
    if film:
        poses = world.trace[:: round(TRACE_RATE / FILM_RATE)]
        figures.save_film(render(world, poses), path, FILM_RATE)
    return session_report.ShownRollout(caption, rollout, path.read_bytes() if film else None)


def _caption(task: Task, executed: Policy, rollout: Rollout, truth: Truth) -> str:
    """Outcome of a rollout as the task observed it and by the simulator's ground truth."""
    judged = task.assess(executed, rollout)
    fault = "" if rollout.fault is None else rollout.fault.text
    judgement = (judged.ret, judged.observation, judged.success, judged.why)
    outcome = task.outcome(Outcome(*judgement, fault, truth))
    ret = "no return" if judged.ret is None else f"return {judged.ret:.3f}"
    facts = ", ".join(
        f"{name.removesuffix('_deg')} {value:.3g}{UNITS.get(name, '')}"
        if isinstance(value, float)
        else WORDS.get(name, name.replace("_", " "))
        for name, value in truth.items()
        if value is True or (isinstance(value, float) and not name.startswith(ARM_TRUTH))
    )
    return f"{outcome}; {ret}. Ground truth: {facts}."


def main(arguments: Sequence[str] | None = None) -> int:
    """`python -m wam_power_ros.in_process.session_answer`: write the report of a session."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("session", type=Path)
    parser.add_argument("--no-film", metavar="REASON", help="render no film, for this reason")
    options = parser.parse_args(arguments)
    try:
        shown = run(options.session, film=options.no_film is None)
        session_report.write(options.session, shown, options.no_film or "")
    except OSError as error:
        sys.exit(durable_files.explained(error))
    return 0


if __name__ == "__main__":
    sys.exit(main())
