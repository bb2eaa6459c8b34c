# SPDX-License-Identifier: Apache-2.0
"""What was never tried: a reach to other goals, or a flip of a pancake of another size.

    python -m reproduction.studies.new_goals [--arm] [--folder DIR] [--seeds N] [--ways WAY ...]
    python -m reproduction.studies.new_goals --pancakes [--folder DIR] [--seeds N] [--workers N]

prints a row for each way to begin: predicted from a session, carried over, taught afresh. The
demonstrations of a reach are drawn as those of the stand-in; a rollout is the path of Eq. 1, with
noise at its end, stopped at the obstacle, and every arm can follow. With `--arm` both are executed
on the simulated arm, by the controller and with its limits.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from hardware_sim.demonstrator import PAUSE
from hardware_sim.scenes.reach import reach
from hardware_sim.settings import REACH_GOAL
from reproduction import jobs as job_cache
from reproduction.jobs import Job
from reproduction.studies import grounds
from reproduction.studies.flip_sessions import NOVICE, stand_in, teach
from wam_power_ros.faults import Fault
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.demonstration import Demonstration, from_positions
from wam_power_ros.learning.policy import Policy, with_id
from wam_power_ros.learning.rollout import EndEffectorPath, Rollout
from wam_power_ros.params import overlay
from wam_power_ros.practice.improvement import ArmModel
from wam_power_ros.practice.new_goal import policy_for
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.regions import Region
from wam_power_ros.tasks.flip.frames import PANCAKE_RADIUS
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
PANCAKE_SEEDS = range(34000, 34020)  # not used for tuning
RADII = (0.075, 0.08, 0.10, 0.12)  # [m]; a session's own pancake has `PANCAKE_RADIUS`


class Place(Protocol):
    """Where demonstrations and rollouts of a session take place."""

    model: ArmModel
    obstacle: Region | None  # None for one around the middle of the demonstrations

    def taught(self, seed: int, goal: Sequence[float]) -> list[Demonstration]:
        """Demonstrations of a reach."""

    def executed(self, task: Reach, policy: Policy, rng: np.random.Generator) -> Rollout:
        """Rollout of a policy."""


class AnyArm:
    """A `practice.ArmModel` that follows every policy."""

    def infeasible(self, policy: Policy, overruns: int = 0) -> Fault | None:
        """See `practice.ArmModel`."""
        return None

    def foresee(self, policy: Policy) -> None:
        """Nothing is foreseen."""


class Equation:
    """Paths of Eq. 1; see the module."""

    model = AnyArm()
    obstacle: Region | None = None

    def taught(self, seed: int, goal: Sequence[float]) -> list[Demonstration]:
        """See `Place`."""
        found = []
        for number in range(DEMONSTRATIONS):
            script = reach(np.random.default_rng([seed, number]), goal)
            t = np.arange(PAUSE, script.end, PERIOD)
            positions = np.stack([script.target(at, START, np.eye(3)).position for at in t])
            found.append(from_positions(positions, PERIOD))
        return found

    def executed(self, task: Reach, policy: Policy, rng: np.random.Generator) -> Rollout:
        """See `Place`."""
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


class SimulatedArm:
    """The simulated arm, with its own noise, controller and limits."""

    def __init__(self, seed: int) -> None:
        setup = overlay.setup(task=Reach.name).changed({"wam_sim": {"seed": seed}})
        self.model = Environment.of(setup)
        self.obstacle = self.model.controller.settings.region

    def taught(self, seed: int, goal: Sequence[float]) -> list[Demonstration]:
        """See `Place`."""
        found = []
        for number in range(DEMONSTRATIONS):
            script = reach(np.random.default_rng([seed, number]), goal)
            recorded = self.model.demonstrate(script, f"demonstration-{number}")
            found.append(Reach.demonstration_of(self.model.arm, *recorded))
        return found

    def executed(self, task: Reach, policy: Policy, rng: np.random.Generator) -> Rollout:
        """See `Place`."""
        return self.model.run(policy)[0]


def practised(place: Place, context: Mapping[str, Any], policy: Policy, seed: int) -> Practice:
    """A finished session of the default preset."""
    practice = Practice(preset("reach", retests=RETESTS), context, [policy], seed, place.model)
    rng = np.random.default_rng([seed, 1])
    while (trial := practice.next_trial()) is not None:
        practice.learn(trial, place.executed(practice.task, trial.policy, rng))
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


def session(seed: int, ways: Sequence[str] = WAYS, on_the_arm: bool = False) -> dict[str, Any]:
    """A session, and others with new goals by every way to begin; None where it predicts none."""
    place: Place = SimulatedArm(seed) if on_the_arm else Equation()
    shown = place.taught(seed, REACH_GOAL)
    centre = tuple(midpoint(resampled(shown)).tolist())
    obstacle = place.obstacle or Region("obstacle", centre, RADIUS)
    context, fitted = Reach.context_of(shown, obstacle), Reach.policy_of(shown, "demonstration-1")
    known = practised(place, context, fitted, seed)
    result: dict[str, Any] = {"origin": outcome(known), **{way: [] for way in ways}}
    for number, goal in enumerate(GOALS, start=1):
        moved, again = known.task.with_goal(context, goal), 100 * seed + number
        wanted = [goal.get(axis, at) for axis, at in zip("xyz", REACH_GOAL, strict=True)]
        new = place.taught(again, wanted)
        begins = {
            "carried over": (moved, None if known.best is None else known.best.policy),
            "demonstrated before": (moved, fitted),
            "taught afresh": (Reach.context_of(new, obstacle), Reach.policy_of(new, "new")),
        }
        try:
            policy, _ = policy_for(
                known.task, known.candidates, known.records, goal, place.model, "predicted"
            )
            begins["predicted"] = (moved, policy)
        except ValueError:  # the session never passed the obstacle
            begins["predicted"] = (moved, None)
        for way in ways:
            there, policy = begins[way]
            begun = None
            if policy is not None:
                begun = practised(place, there, with_id(policy, "begun"), again)
            result[way].append(None if begun is None else outcome(begun))
    return result


def line(
    outcomes: Sequence[Mapping[str, Any] | None], robust: float = 0.9 * RETESTS
) -> dict[str, Any]:
    """Statistics of sessions: their number, first successes, rollouts and the share confirmed.

    Args:
        outcomes: See `outcome`; None for a session that could not begin.
        robust: Successes among its re-tests from which on an answer is robust.
    """
    found = [each for each in outcomes if each is not None]
    first = [each["first"] or np.inf for each in found]
    return {
        "sessions": len(outcomes),
        "begun": len(found),
        "first rollout succeeds": sum(each == 1 for each in first),
        "first success": [float(q) for q in np.quantile(first, (0.0, 0.5, 1.0), method="lower")],
        "confirmed": sum(each["confirmed"] > 0 for each in found),
        "rollouts": float(np.median([each["used"] for each in found])),
        "robust": sum(each["successes"] >= robust for each in found),
    }


def flipped(environment: Environment, policy: Policy, seed: int) -> Practice:
    """A finished session of the default preset that begins with a policy."""
    settings = preset("flip", budget=grounds.BUDGET, retests=grounds.RETESTS)
    practice = Practice(settings, {}, [policy], seed, environment)
    for _ in environment.practise(practice):
        pass
    return practice


def flips_of(practice: Practice) -> dict[str, Any]:
    """See `outcome`; of the re-tests the true flips count."""
    retests = [record.truth or {} for record in practice.records if record.kind == "retest"]
    flips = sum(bool(truth.get("true_flip")) for truth in retests)
    return {**outcome(practice), "successes": flips}


def pancakes(seed: int, radii: Sequence[float] = RADII) -> dict[str, Any]:
    """A session of a novice, and others with other pancakes by every way to begin."""
    environment = stand_in(seed)
    (shown,) = teach(environment, seed, 1, NOVICE)
    known = flipped(environment, shown, seed)
    result: dict[str, Any] = {"origin": flips_of(known)}
    for number, radius in enumerate(radii, start=1):
        again = 100 * seed + number
        for way in WAYS[1:]:
            there = stand_in(again, body_size=radius / PANCAKE_RADIUS)
            policy: Policy | None = shown
            if way == "carried over":
                policy = None if known.best is None else known.best.policy
            elif way == "taught afresh":
                (policy,) = teach(there, again, 1, NOVICE)
            begun = None if policy is None else flipped(there, with_id(policy, "begun"), again)
            result[f"{way}, {radius}"] = None if begun is None else flips_of(begun)
    return result


def rows(results: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Outcomes by way and radius, and those of all radii by way."""
    found = {key: [each[key] for each in results] for key in results[0]}
    for way in WAYS[1:]:
        found[way] = [one for key, ones in found.items() if key.startswith(way) for one in ones]
    return found


def main() -> None:
    """Run the sessions and print a line for each way to begin, and each size of a pancake."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--folder", type=Path, default=Path("new_goals"))
    parser.add_argument("--seeds", type=int, default=len(HELD_OUT))
    parser.add_argument("--arm", action="store_true", help="execute on the simulated arm")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--pancakes", action="store_true", help="of other sizes")
    args = parser.parse_args()
    if args.pancakes:
        seeds = PANCAKE_SEEDS[: args.seeds]
        wanted = [Job("pancakes", f"seed-{s}", pancakes, {"seed": s}) for s in seeds]
        found = job_cache.run(wanted, args.folder, workers=args.workers)["pancakes"]
        table, robust = rows(list(found.values())), float(grounds.SOLVED)
    else:
        name, own = "arm" if args.arm else "goals", {"ways": args.ways, "on_the_arm": args.arm}
        seeds = HELD_OUT[: args.seeds]
        wanted = [Job(name, f"seed-{s}", session, {"seed": s, **own}) for s in seeds]
        found = job_cache.run(wanted, args.folder, workers=args.workers)[name]
        table, robust = {"origin": [each["origin"] for each in found.values()]}, 0.9 * RETESTS
        table |= {way: [one for each in found.values() for one in each[way]] for way in args.ways}
    for key, outcomes in table.items():
        sys.stdout.write(f"{key}: {line(outcomes, robust)}\n")


if __name__ == "__main__":
    main()
