# SPDX-License-Identifier: Apache-2.0
"""Whole sessions of the pancake task in one process: teach a series, choose, practise, re-test."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from hardware_sim.hand import wrist_flick
from wam_power_ros.demonstration import from_joint_samples
from wam_power_ros.experiments.bench import Bench
from wam_power_ros.policy import Policy
from wam_power_ros.practice import Practice
from wam_power_ros.presets import PracticeSettings
from wam_power_ros.primitive import PANCAKE, FitSettings, fit
from wam_power_ros.records import Record


def teach(bench: Bench, seed: int, count: int, settings: FitSettings = PANCAKE) -> list[Policy]:
    """Policies fitted to a small series of demonstrations by the hand.

    Args:
        bench: where it is taught.
        seed: of the hand; demonstration k of a seed is always the same.
        count: of demonstrations.
        settings: of the fit.
    """
    policies = []
    for number in range(count):
        script = wrist_flick(np.random.default_rng([seed, number]))
        stamps_ns, q = bench.demonstrate(script, f"demonstration-{number}")
        demonstration = from_joint_samples(bench.arm, stamps_ns, q)
        policies.append(fit([demonstration], settings, f"demonstration-{number + 1}"))
    return policies


def practise(
    bench: Bench,
    candidates: list[Policy],
    settings: PracticeSettings,
    seed: int,
    report: Callable[[Record], None] | None = None,
) -> Practice:
    """One session on the bench, from the reproductions to the last re-test.

    Args:
        bench: where it is practised.
        candidates: fitted policies to choose from.
        settings: of the session.
        seed: of the exploration.
        report: called with every record.
    """
    practice = Practice(candidates, settings, seed, bench.forbids)
    while (trial := practice.next_trial()) is not None:
        pan, pancake, truth, fault = bench.run(trial.policy)
        record = practice.learn(trial, pan, pancake, fault=fault, truth=dataclasses.asdict(truth))
        if report is not None:
            report(record)
    return practice
