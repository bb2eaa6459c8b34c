# SPDX-License-Identifier: Apache-2.0
"""Ball-in-a-cup taught by a person who misses, with one demonstration: learners side by side.

python -m reproduction.studies ball_in_cup --seeds 20        # the practised: --only practised
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from reproduction.studies.grounds import of_preset
from reproduction.studies.table import Table
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.params import overlay
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.ball_in_cup.task import BallInCup

TASK = BallInCup.name
RETESTS = 30  # of the final policy
SOLVED = 27  # or more of them in the cup in a solved session
NEAR_MISS = 0.05  # [m] beside the middle of the cup, from where a ball usually falls into it
HELD_OUT = range(18000, 18020)  # seeds not used for tuning


DEMONSTRATORS: Mapping[str, Mapping[str, Any]] = {  # arguments of `session`
    "novice": {},
    "practised": {"spread": 1.0},
    "camera": {"camera": True},
    **{f"joint 1 at {angle} degrees": {"joint_1": angle} for angle in (-90, -45, 30, 90)},
}
LEARNERS = {
    "model_based": of_preset("miss, its rough slopes", "model_based", retests=RETESTS),
    "cup": of_preset("return, miss", "cup", retests=RETESTS),
    "corrections": of_preset("miss", "corrections_only", retests=RETESTS),
    "power": of_preset("return", "return_only", retests=RETESTS),
    **{
        name: of_preset("return", "return_only", name, retests=RETESTS)
        for name in ("cma_es", "pi2_bb", "random")
    },
    "kober": of_preset("return", "kober", retests=RETESTS),
}


def session(
    seed: int,
    name: str,
    changes: Mapping[str, Any],
    spread: float | None = None,
    joint_1: float = 0.0,
    camera: bool = False,
) -> dict[str, Any]:
    """Run a session from its demonstration to its re-tests; return plain data.

    It ends with the re-test that decides that it is not solved.

    Args:
        seed: Seed of the demonstrator, the stand-in and the exploration.
        name: Name of the preset.
        changes: Changes to the preset.
        spread: Spread of the demonstrations; None for that of the task's set-up.
        joint_1: Its angle at the begin [degrees].
        camera: Whether the ball is seen in images.
    """
    own = {"seed": seed} if spread is None else {"seed": seed, "spread": spread}
    seen = {"camera": camera}
    setup = overlay.setup(task=TASK).changed({"wam_sim": own, "optitrack_sim": seen})
    environment = Environment.from_setup(setup)
    scene = environment.world.scene
    scene.home = np.array([np.radians(joint_1), *scene.home[1:]])
    script = scene.script(np.random.default_rng([seed, 0]))
    recorded = environment.demonstrate(script, "demonstration-0")
    demonstration = BallInCup.demonstration_of(environment.arm, *recorded)
    policy = BallInCup.policy_of([demonstration], "demonstration-1")
    context = BallInCup.context_of([demonstration], None)
    practice = Practice(preset(TASK, name, **changes), context, [policy], seed, environment)
    records, failed = [], 0
    for record in environment.practise(practice):
        records.append(record)
        failed += record.kind == "retest" and not record.truth["caught"]
        if failed > RETESTS - SOLVED:
            break
    return {
        "used": practice.used,
        "stopped": practice.stopped,
        "confirmed": practice.confirmed > 0,
        "trials": [
            {
                "kind": record.kind,
                "ret": record.ret,
                "fault": record.fault,
                "distance": record.truth["distance"],
                "caught": record.truth["caught"],
            }
            for record in records
        ],
    }


def line(sessions: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Statistics of the sessions of a row.

    Returns:
        "sessions": their number; "near": those whose reproduction came down within NEAR;
        "solved": those with at least SOLVED re-tests in the cup; "confirmed": those that the
        stopping rule ended; "rollouts": median, least and most of the number of rollouts,
        confirmation included, where a session without one counts with its budget.
    """
    caught = [
        sum(trial["caught"] for trial in each["trials"] if trial["kind"] == "retest")
        for each in sessions
    ]
    first = [each["trials"][0]["distance"] for each in sessions]
    return {
        "sessions": len(sessions),
        "near": sum(distance is not None and distance < NEAR_MISS for distance in first),
        "solved": sum(count >= SOLVED for count in caught),
        "confirmed": sum(each["confirmed"] for each in sessions),
        "rollouts": np.quantile([each["used"] for each in sessions], (0.5, 0.0, 1.0)).tolist(),
    }


TABLE = Table(DEMONSTRATORS, LEARNERS, HELD_OUT, session, line, (("novice",), None))
