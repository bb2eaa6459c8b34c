# SPDX-License-Identifier: Apache-2.0
"""Drivers that measure well and report as drivers do: with jitter, lag and repetitions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hardware_sim.wam import PERIOD_NS
from hardware_sim.world import JointSample, World


@dataclass(frozen=True)
class Habits:
    """How a driver reports its measurements.

    Attributes:
        jitter: Standard deviation of the stamps [s]; its clock never runs back.
        lag: Time constant of a filter of the velocities, after the encoders' own [s]; 0 for none.
        repeats: Number of states with the same measurement.
    """

    jitter: float = 0.0
    lag: float = 0.0
    repeats: int = 1


HONEST = {
    "stamps that jitter by 0.3 ms": Habits(jitter=3e-4),
    "stamps that jitter by 0.6 ms": Habits(jitter=6e-4),
    "velocities behind a filter of 10 ms": Habits(lag=0.01),
    "250 Hz under 500 Hz stamps": Habits(repeats=2),
}


def report(world: World, habits: Habits, seed: int) -> None:
    """Let a world report its joint states with these habits; `seed` is that of the jitter."""
    measure, rng = world.joint_state, np.random.default_rng(seed)
    share = 1.0 - math.exp(-PERIOD_NS * 1e-9 / habits.lag) if habits.lag else 1.0
    filtered, held, last_ns = np.zeros(7), measure(), 0
    told = held, measure()  # the last measurement and what was reported of it

    def joint_state() -> JointSample:
        nonlocal filtered, held, last_ns, told
        sample = measure()
        if sample.stamp_ns == told[0].stamp_ns:
            return told[1]
        # Where the simulation puts the arm somewhere else, its driver starts anew.
        filtered = sample.qd if world.frozen else filtered + share * (sample.qd - filtered)
        if world.frozen or sample.stamp_ns // PERIOD_NS % habits.repeats == 0:
            held = sample._replace(qd=filtered.copy())
        stamp_ns = sample.stamp_ns + round(1e9 * habits.jitter * rng.standard_normal())
        last_ns = max(stamp_ns, last_ns + 1000)
        told = sample, held._replace(stamp_ns=last_ns)
        return told[1]

    world.joint_state = joint_state  # type: ignore[method-assign]
