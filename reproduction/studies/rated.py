# SPDX-License-Identifier: Apache-2.0
"""The task `rated`: a simulated person wants the end of a movement elsewhere, and says how near."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from reproduction.studies.table import Row, Table
from wam_power_ros.learning.policy import Basis, Policy
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.rated import assessed

DISTANCE, NOUGHT = 0.07, 0.15  # [m] of the wanted end; of an end that is rated 0
NEAR_MISS, ROLLOUTS = 0.4, 60  # share of the first error, at most
# Share of ratings that are any at all
PERSONS = {"a person": {"errs": 0.0}, "a person who errs": {"errs": 0.1}}
VARIANTS = {name: Row("ratings", {"variant": name}) for name in ("shifts", "attractors", "full")}
HELD_OUT = range(1000, 1020)  # seeds not used for tuning


class Arm:
    """An arm on which every policy is feasible; see `practice.ArmModel`."""

    def infeasible(self, policy: Policy, limit_stops: int = 0) -> None: ...  # noqa: D102
    def simulate(self, policy: Policy) -> None: ...  # noqa: D102


def session(seed: int, variant: str, errs: float) -> dict[str, float]:
    """Run a session; return the number of its rollouts and the share of the error that is left."""
    lift = np.tile([0.6, 0.0, 0.5], (8, 1)) + np.outer([0, 0, 1, 1, 1, 0, 0, 0], [0.0, 0.0, 0.05])
    stiffness = np.tile(300.0 * np.eye(3), (8, 1, 1))
    turn = (np.eye(4)[3], np.zeros((8, 3)), 400.0, 36.0)  # the rotation is not wanted elsewhere
    shown = Policy("shown", Basis(8, 0.4, 0.001), stiffness, lift, 32.0, *turn, np.zeros(7))
    way = (rng := np.random.default_rng(seed)).standard_normal(3)
    wanted = lift[-1] + DISTANCE * way / np.linalg.norm(way)
    practice = Practice(preset("rated", budget=ROLLOUTS, variant=variant), {}, [shown], seed, Arm())
    while (trial := practice.next_trial()) is not None:
        off = np.linalg.norm(trial.policy.attractors[-1] - wanted)
        rating = rng.integers(10) if rng.random() < errs else round(9 * max(0, 1 - off / NOUGHT))
        practice.learn_assessed(trial, assessed(rating / 9))
    off = np.linalg.norm(practice.best.policy.attractors[-1] - wanted)
    return {"used": practice.used, "left": float(off) / DISTANCE}


def line(sessions: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Sessions that end near, medians of the share of the error left and of the rollouts."""
    left, used = ([each[key] for each in sessions] for key in ("left", "used"))
    medians = {"left": round(float(np.median(left)), 2), "rollouts": float(np.median(used))}
    return {"near": sum(share < NEAR_MISS for share in left), **medians}


TABLE = Table(PERSONS, VARIANTS, HELD_OUT, session, line)
