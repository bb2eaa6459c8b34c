# SPDX-License-Identifier: Apache-2.0
"""Reaching to goals that were never tried: predicted from a session, carried over, taught afresh.

    python -m reproduction.studies.new_goals [--folder DIR] [--seeds N]

prints a row for each way to begin. Demonstrations are drawn as those of the stand-in; a rollout is
the path of Eq. 1, with noise at its end, stopped at the obstacle. Every arm can follow.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hardware_sim.demonstrator import PAUSE
from hardware_sim.scenes.reach import reach
from hardware_sim.settings import REACH_GOAL
from reproduction import jobs as job_cache
from reproduction.jobs import Job
from wam_power_ros.faults import Fault
from wam_power_ros.learning.demonstration import Demonstration, from_positions
from wam_power_ros.learning.policy import Policy, with_id
from wam_power_ros.learning.rollout import EndEffectorPath, Rollout
from wam_power_ros.practice.new_goal import policy_for
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.regions import Region
from wam_power_ros.tasks.reach.scenario import RADIUS, midpoint, resampled
from wam_power_ros.tasks.reach.task import Reach

HELD_OUT = range(33000, 33012)  # seeds not used for tuning
START = np.array([0.780, -0.248, 0.600])  # [m] of the tool
PERIOD = 0.004  # [s] of a recording
DEMONSTRATIONS = 4
RETESTS = 20
NOISE = 0.004  # standard deviation of the end of a path, per axis [m]
GOALS: tuple[Mapping[str, float], ...] = (  # 8 to 11 cm from the demonstrated one
    {"y": 0.35},
    {"y": 0.15},
    {"x": 0.70},
    {"z": 0.70},
    {"x": 0.84, "y": 0.30, "z": 0.52},
)
WAYS = ("predicted", "carried over", "demonstrated before", "taught afresh")


class AnyArm:
    """A `practice.ArmModel` that follows every policy."""

    def infeasible(self, policy: Policy, overruns: int = 0) -> Fault | None:
        """See `practice.ArmModel`."""
        return None

    def foresee(self, policy: Policy) -> None:
        """Nothing is foreseen."""

    def tool_position(self, q: np.ndarray) -> np.ndarray:
        """See `practice.ArmModel`."""
        return START


def taught(seed: int, goal: Sequence[float] = REACH_GOAL) -> list[Demonstration]:
    """Demonstrations of a reach."""
    found = []
    for number in range(DEMONSTRATIONS):
        script = reach(np.random.default_rng([seed, number]), goal)
        t = np.arange(PAUSE, script.end, PERIOD)
        positions = np.stack([script.target(at, START, np.eye(3)).position for at in t])
        found.append(from_positions(positions, PERIOD))
    return found


def executed(task: Reach, policy: Policy, rng: np.random.Generator) -> Rollout:
    """Rollout of a policy; see the module."""
    scenario = task._scenario(policy, START)
    path = scenario.free_paths(policy.stiffness[np.newaxis], policy.attractors[np.newaxis])
    share = np.linspace(0.0, 1.0, scenario.steps)[:, np.newaxis]
    stopped, touched = scenario.stopped_paths(path + share * rng.normal(0.0, NOISE, 3))
    t = np.arange(scenario.steps) * scenario.period
    t = np.append(t, policy.basis.duration + task.settle_time)
    position = np.vstack([stopped[0], stopped[0, -1:]])
    level = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    tool = EndEffectorPath(policy.id, t, position, level)
    return Rollout(tool, None, None, "obstacle" if touched[0] else "")


def practised(context: Mapping[str, Any], policy: Policy, seed: int) -> Practice:
    """A finished session of the default preset."""
    practice = Practice(preset("reach", retests=RETESTS), context, [policy], seed, AnyArm())
    rng = np.random.default_rng([seed, 1])
    while (trial := practice.next_trial()) is not None:
        practice.learn(trial, executed(practice.task, trial.policy, rng))
    return practice


def outcome(practice: Practice) -> dict[str, Any]:
    """Result of a session: its first success, rollouts, successes that confirmed, re-tests."""
    records = practice.records
    return {
        "first": next((r.number for r in records if r.success and r.kind != "retest"), None),
        "used": practice.used,
        "confirmed": practice.confirmed,
        "successes": sum(r.success for r in records if r.kind == "retest"),
    }


def session(seed: int) -> dict[str, Any]:
    """A session, and others with new goals by every way to begin; None where it predicts none."""
    shown = taught(seed)
    centre = tuple(midpoint(resampled(shown)).tolist())
    obstacle = Region("obstacle", centre, RADIUS)
    context, fitted = Reach.context_of(shown, obstacle), Reach.policy_of(shown, "demonstration-1")
    known = practised(context, fitted, seed)
    result: dict[str, Any] = {"origin": outcome(known), **{way: [] for way in WAYS}}
    for number, goal in enumerate(GOALS, start=1):
        moved, again = known.task.with_goal(context, goal), 100 * seed + number
        wanted = [goal.get(axis, at) for axis, at in zip("xyz", REACH_GOAL, strict=True)]
        new = taught(again, wanted)
        begins = {
            "carried over": (moved, None if known.best is None else known.best.policy),
            "demonstrated before": (moved, fitted),
            "taught afresh": (Reach.context_of(new, obstacle), Reach.policy_of(new, "new")),
        }
        try:
            policy, _ = policy_for(
                known.task, known.candidates, known.records, goal, AnyArm(), "predicted"
            )
            begins["predicted"] = (moved, policy)
        except ValueError:  # the session never passed the obstacle
            begins["predicted"] = (moved, None)
        for way, (there, policy) in begins.items():
            begun = None if policy is None else practised(there, with_id(policy, "begun"), again)
            result[way].append(None if begun is None else outcome(begun))
    return result


def line(outcomes: Sequence[Mapping[str, Any] | None]) -> dict[str, Any]:
    """Statistics of sessions: their number, first successes, rollouts and the share confirmed."""
    found = [each for each in outcomes if each is not None]
    first = [each["first"] or np.inf for each in found]
    return {
        "sessions": len(outcomes),
        "begun": len(found),
        "first rollout succeeds": sum(each == 1 for each in first),
        "first success": [float(q) for q in np.quantile(first, (0.0, 0.5, 1.0), method="lower")],
        "confirmed": sum(each["confirmed"] > 0 for each in found),
        "rollouts": float(np.median([each["used"] for each in found])),
        "robust": sum(each["successes"] >= 0.9 * RETESTS for each in found),
    }


def main() -> None:
    """Run the sessions and print a line for each way to begin."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--folder", type=Path, default=Path("new_goals"))
    parser.add_argument("--seeds", type=int, default=len(HELD_OUT))
    args = parser.parse_args()
    wanted = [Job("goals", f"seed-{s}", session, {"seed": s}) for s in HELD_OUT[: args.seeds]]
    results = list(job_cache.run(wanted, args.folder, workers=1)["goals"].values())
    sys.stdout.write(f"origin: {line([each['origin'] for each in results])}\n")
    for way in WAYS:
        sys.stdout.write(f"{way}: {line([one for each in results for one in each[way]])}\n")


if __name__ == "__main__":
    main()
