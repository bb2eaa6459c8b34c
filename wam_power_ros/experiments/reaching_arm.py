# SPDX-License-Identifier: Apache-2.0
"""Reaching taught on the simulated arm, learnt on Eq. 1, and executed by the torque controller.

The four demonstrations are bags/reach_*. The sphere is in nobody's way but the path's: the arm
does not feel it. Whether the executed path clears it is reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from hardware_sim.world import JOINTS, World
from wam_power_ros.bags import read_demonstration
from wam_power_ros.demonstration import from_joint_samples
from wam_power_ros.experiments.bench import Bench
from wam_power_ros.experiments.reaching_chapter import EXECUTED, TAUGHT, VARIANTS
from wam_power_ros.experiments.reaching_runs import DRAWN, NOISE, as_data, study
from wam_power_ros.experiments.scenario import Scenario, taught
from wam_power_ros.experiments.studies import Job
from wam_power_ros.parameters import Parameters
from wam_power_ros.resources import share

NOISE_SEED = 7  # of the stand-in


def jobs(seeds: Sequence[int], rollouts: int) -> list[Job]:
    """Runs of both variants, and the execution of the first seed's policy of each."""
    found = []
    for variant in VARIANTS:
        arguments = {"variant": variant, "seeds": list(seeds), "rollouts": rollouts}
        found.append(Job(TAUGHT, f"{variant}-{seeds[0]}-{seeds[-1]}", taught_runs, arguments))
        one = {"variant": variant, "seed": seeds[0], "rollouts": rollouts}
        found.append(Job(EXECUTED, variant, executed_run, one))
    return found


def taught_runs(variant: str, seeds: list[int], rollouts: int) -> dict[str, Any]:
    """PoWER on the taught scenario, as data."""
    scenario = taught_scenario()
    return as_data(study(variant, seeds, rollouts, scenario), seeds, variant, scenario)


def executed_run(variant: str, seed: int, rollouts: int) -> dict[str, Any]:
    """The policy PoWER ends with, executed on the arm beside what Eq. 1 plans for it."""
    scenario = taught_scenario()
    (run,) = study(variant, [seed], rollouts, scenario)
    parameters = Parameters(scenario.policy, variant, NOISE[variant])
    policy, _ = parameters.policy(run.mean, "reach-0001")
    bench = Bench(World(seed=NOISE_SEED))
    pan, _, _, fault = bench.run(policy)
    planned = scenario.free(policy.stiffness[np.newaxis], policy.attractors[np.newaxis])[0]
    t = np.arange(scenario.steps) * scenario.period
    executed = np.stack([np.interp(t, pan.t, x) for x in pan.position.T], axis=1)
    shown = np.linspace(0, scenario.steps - 1, DRAWN).round().astype(int)
    deviation = np.linalg.norm(executed - planned, axis=1)
    away = np.linalg.norm(executed - scenario.obstacle, axis=1)
    return {
        "variant": variant,
        "seed": seed,
        "fault": fault,
        "planned": planned[shown].round(5).tolist(),
        "executed": executed[shown].round(5).tolist(),
        "rms": float(np.sqrt((deviation**2).mean())),
        "largest": float(deviation.max()),
        "clearance": float(away.min() - scenario.radius),
        "planned_clearance": float(
            np.linalg.norm(planned - scenario.obstacle, axis=1).min() - scenario.radius
        ),
        "planned_return": run.final,
        "executed_return": float(scenario.worth(scenario.stopped(executed[np.newaxis])[0])[0]),
    }


@cache
def taught_scenario() -> Scenario:
    """The scenario of the shipped bags: positions of the tool."""
    arm = Bench(World(seed=NOISE_SEED)).arm
    bags = sorted(share("bags").glob("reach_*"))
    demonstrations = [from_joint_samples(arm, *read_demonstration(bag, JOINTS)) for bag in bags]
    return taught(demonstrations)
