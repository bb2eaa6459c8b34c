# SPDX-License-Identifier: Apache-2.0
"""Reaching taught on the simulated arm, learnt on Eq. 1, and executed by the arm.

The four demonstrations are bags/reach_*. The simulated world has no sphere: a learnt policy is
executed to see whether its path clears the place of the sphere.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from hardware_sim.scenes import scene_type
from hardware_sim.wam import JOINTS
from hardware_sim.world import World
from reproduction.jobs import Job
from reproduction.studies import reaching_runs
from reproduction.studies.reaching_runs import NOISE, VARIANTS, as_data, study
from reproduction.studies.reaching_scenario import RADIUS, Scenario
from wam_power_ros.bags.reader import read_demonstration
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.demonstration import from_joint_samples
from wam_power_ros.learning.dmp import fit
from wam_power_ros.learning.parametrization import parametrization_of
from wam_power_ros.learning.policy import Policy
from wam_power_ros.params.resources import share
from wam_power_ros.tasks.reach.paths import STEPS, resampled
from wam_power_ros.tasks.reach.settings import REACH_FIT

TAUGHT, EXECUTED = "reaching-taught", "reaching-executed"  # studies
NOISE_SEED = 7  # of the stand-in


def jobs(seeds: Sequence[int], rollouts: int) -> list[Job]:
    """Runs of both variants, and execution of a learnt policy of each."""
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
    """Execute the final policy of PoWER on the arm; compare its path with the plan of Eq. 1."""
    scenario = taught_scenario()
    (run,) = study(variant, [seed], rollouts, scenario)
    parameters = parametrization_of(scenario.policy, variant, NOISE[variant])
    policy, _ = parameters.policy(run.mean, "reach-0001")
    environment = Environment(World(scene_type("flip"), seed=NOISE_SEED))
    executed, fault = _executed(environment, policy, scenario)
    planned = scenario.free_paths(policy.stiffness[np.newaxis], policy.attractors[np.newaxis])[0]
    shown = np.linspace(0, STEPS - 1, reaching_runs.PATH_SAMPLES).round().astype(int)
    deviation = np.linalg.norm(executed - planned, axis=1)
    return {
        "variant": variant,
        "seed": seed,
        "fault": fault,
        "planned": planned[shown].round(5).tolist(),
        "executed": executed[shown].round(5).tolist(),
        "rms": float(np.sqrt((deviation**2).mean())),
        "largest": float(deviation.max()),
        "clearance": _clearance(executed, scenario),
        "planned_clearance": _clearance(planned, scenario),
        "planned_return": run.final,
        "executed_return": float(
            scenario.returns(scenario.stopped_paths(executed[np.newaxis])[0])[0]
        ),
    }


def _clearance(path: np.ndarray, scenario: Scenario) -> float:
    """Least distance of a path (T, 3) from the surface of the sphere [m]."""
    return float(np.linalg.norm(path - scenario.obstacle, axis=1).min() - RADIUS)


def _executed(
    environment: Environment, policy: Policy, scenario: Scenario
) -> tuple[np.ndarray, str]:
    """Path of the tool (T, 3) [m] at the samples of the scenario, and the fault or ""."""
    rollout, _ = environment.run(policy)
    t = np.arange(STEPS) * scenario.period
    path = [np.interp(t, rollout.tool.t, x) for x in rollout.tool.position.T]
    return np.stack(path, axis=1), "" if rollout.fault is None else rollout.fault.text


@cache
def taught_scenario() -> Scenario:
    """Scenario of the tool paths of the shipped demonstrations, scaled in time to their mean."""
    arm = Environment(World(scene_type("flip"), seed=NOISE_SEED)).arm
    bags = sorted(share("bags").glob("reach_*"))
    demonstrations = [from_joint_samples(arm, *read_demonstration(bag, JOINTS)) for bag in bags]
    policy = fit(demonstrations, REACH_FIT, "demonstration")
    # begins where the tool is at the q_start of the policy
    return Scenario(resampled(demonstrations), policy, demonstrations[0].position[0])
