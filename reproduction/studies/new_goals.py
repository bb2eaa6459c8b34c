# SPDX-License-Identifier: Apache-2.0
"""Goals that were never tried, of every task: predicted from a session, or its policy as it is.

    python -m reproduction.studies new_goals [--only TASK ...]

Flips and swings are executed on the simulated arm. A reach is the path of Eq. 1, with noise at its
end, stopped at the obstacle: every arm can follow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from hardware_sim.demonstrator import PAUSE
from hardware_sim.scenes.reach import reach
from reproduction.studies.reaching_scenario import RADIUS, free_paths, midpoint
from reproduction.studies.table import Row, Table
from wam_power_ros import installed
from wam_power_ros.faults import Fault
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.demonstration import Demonstration, from_positions
from wam_power_ros.learning.policy import Policy, with_id
from wam_power_ros.learning.rollout import EndEffectorPath, Rollout
from wam_power_ros.params import overlay
from wam_power_ros.practice.new_goal import context_for, policy_for
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.regions import Region
from wam_power_ros.tasks.reach.paths import STEPS, resampled, stopped_paths
from wam_power_ros.tasks.reach.task import Reach

HELD_OUT = range(18000, 18020)  # seeds not used for tuning; the k-th has the k-th goal in turn
START = np.array([0.780, -0.248, 0.600])  # [m] of the tool of a reach
PERIOD = 0.004  # [s] of its recording
NOISE = 0.004  # standard deviation of the end of its path, per axis [m]
RETESTS = 20
ROBUST = 18  # re-tests that succeed, from which on an answer is robust
GOALS: Mapping[str, Sequence[Mapping[str, float]]] = {
    "reach": (  # 8 to 11 cm from the demonstrated one
        {"y": 0.35},
        {"y": 0.15},
        {"x": 0.70},
        {"z": 0.70},
        {"x": 0.84, "y": 0.30, "z": 0.52},
        {"z": 0.51},
        {"x": 0.87},
        {"x": 0.72, "y": 0.32},
        {"y": 0.19, "z": 0.53},
        {"x": 0.73, "y": 0.31, "z": 0.66},
    ),
    "ball_in_cup": ({"string": 0.35}, {"string": 0.30}, {"string": 0.25}),  # instead of 0.40 m
    "flip": ({"apex": 0.55}, {"apex": 0.50}, {"apex": 0.45}),  # most are tossed to about 0.60 m
}
WAYS = {  # what each session begins with
    "origin": "demonstrations",
    "predicted": "the policy predicted for the goal",
    "carried over": "the policy of the session before, as it is",
}


class Equation:
    """Paths of Eq. 1 as an arm; see the module."""

    def infeasible(self, policy: Policy, limit_stops: int = 0) -> Fault | None:
        """See `practice.ArmModel`: it follows every policy."""
        return None

    def simulate(self, policy: Policy) -> None:
        """Nothing is simulated."""

    def executed(self, task: Reach, policy: Policy, rng: np.random.Generator) -> Rollout:
        """Rollout of a policy."""
        arrays = policy.stiffness[np.newaxis], policy.attractors[np.newaxis]
        share, duration = np.linspace(0.0, 1.0, STEPS)[:, np.newaxis], policy.basis.duration
        path = free_paths(policy, START, *arrays) + share * rng.normal(0.0, NOISE, 3)
        stopped, touched = stopped_paths(path, np.array(task.region.centre), task.region.radius)
        t = np.arange(STEPS) * (duration / (STEPS - 1))
        t = np.append(t, duration + task.settle_time)
        position = np.vstack([stopped[0], stopped[0, -1:]])
        level = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
        tool = EndEffectorPath(policy.id, t, position, level)
        return Rollout(tool, None, None, "obstacle" if touched[0] else "")


def place(task: str, seed: int, goal: Mapping[str, float]) -> Environment | Equation:
    """Where a session takes place; the ball hangs on the string of the goal."""
    if task == Reach.name:
        return Equation()
    own = {"seed": seed} | ({"string": goal["string"]} if "string" in goal else {})
    return Environment.from_setup(overlay.setup(task=task).changed({"wam_sim": own}))


def taught(task: str, seed: int, arm: Environment | Equation) -> list[Demonstration]:
    """Four demonstrations of a reach, of all else one."""
    if isinstance(arm, Environment):
        script = arm.world.scene.script(np.random.default_rng([seed, 0]))
        recorded = arm.demonstrate(script, "demonstration-0")
        return [installed.task_type(task).demonstration_of(arm.arm, *recorded)]
    found = []
    for number in range(4):
        shown = reach(np.random.default_rng([seed, number]))
        t = np.arange(PAUSE, shown.end, PERIOD)
        path = np.stack([shown.target(at, START, np.eye(3)).position for at in t])
        found.append(from_positions(path, PERIOD))
    return found


def practised(
    task: str, seed: int, arm: Environment | Equation, context: Mapping[str, Any], policy: Policy
) -> Practice:
    """A finished session of the default preset."""
    practice = Practice(preset(task, retests=RETESTS), context, [policy], seed, arm)
    if isinstance(arm, Environment):
        list(arm.practise(practice))
        return practice
    rng = np.random.default_rng([seed, 1])
    while (trial := practice.next_trial()) is not None:
        practice.learn(trial, arm.executed(practice.task, trial.policy, rng))
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


@cache
def known(task: str, seed: int) -> tuple[Practice, Mapping[str, Any]]:
    """The session for the demonstrated goal, and its context."""
    arm, kind = place(task, seed, {}), installed.task_type(task)
    shown = taught(task, seed, arm)
    obstacle = Region("obstacle", tuple(midpoint(resampled(shown)).tolist()), RADIUS)
    context = kind.context_of(shown, obstacle if task == Reach.name else None)
    policy = kind.policy_of(shown, "demonstration-1")
    return practised(task, seed, arm, context, policy), context


def session(seed: int, task: str, way: str) -> dict[str, Any] | None:
    """A session that begins in one of `WAYS`; None where nothing can be begun."""
    before, context = known(task, seed)
    if way == "origin":
        return outcome(before)
    goal, again = GOALS[task][seed % len(GOALS[task])], 100 * seed
    moved, there = context_for(before.settings, context, goal), place(task, again, goal)
    policy = None if before.best is None else before.best.policy
    if way == "predicted":
        new, of = before.settings.make_task(moved), (before.candidates, before.records)
        try:
            policy, _ = policy_for(new, before.task, *of, there, "predicted")
        except ValueError:  # no rollout told an error
            policy = None
    if policy is None:
        return None
    return outcome(practised(task, again, there, moved, with_id(policy, "begun")))


def line(outcomes: Sequence[Mapping[str, Any] | None]) -> dict[str, Any]:
    """Statistics of sessions: their number, first successes, rollouts and the share confirmed.

    Args:
        outcomes: See `outcome`; None for a session that could not begin.
    """
    found = [each for each in outcomes if each is not None]
    first = [each["first"] or np.inf for each in found]
    return {
        "sessions": len(outcomes),
        "begun": len(found),
        "first rollout succeeds": sum(each == 1 for each in first),
        "first success": [float(q) for q in np.quantile(first, (0.0, 0.5, 1.0), method="lower")],
        "confirmed": sum(each["confirmed"] > 0 for each in found),
        "rollouts": np.quantile([each["used"] for each in found], (0.0, 0.5, 1.0)).tolist(),
        "robust": sum(each["successes"] >= ROBUST for each in found),
    }


TABLE = Table(
    {task: {"task": task} for task in GOALS},
    {way: Row(begins_with, {"way": way}) for way, begins_with in WAYS.items()},
    HELD_OUT,
    session,
    line,
)
