# SPDX-License-Identifier: Apache-2.0
"""Reaching taught on the simulated arm, and learnt on Eq. 1 or on the arm.

The four demonstrations are bags/reach_*. The simulated world has no sphere: a policy learnt on
Eq. 1 is executed to see whether its path clears the sphere; practice on the arm learns from the
returns of executed paths.
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
from reproduction.studies.reaching_runs import NOISE, POWER, VARIANTS, as_data, study
from wam_power_ros.bags.reader import read_demonstration
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.demonstration import from_joint_samples
from wam_power_ros.learning.parametrization import parametrization_of
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.power import Power
from wam_power_ros.params.resources import share
from wam_power_ros.tasks.reach.scenario import Scenario, scenario_of

# studies
TAUGHT, EXECUTED, PRACTISED = "reaching-taught", "reaching-executed", "reaching-practised"
NOISE_SEED = 7  # of the stand-in
PRACTICE_MAX = 60  # rollouts on the arm per run
PRACTISING = 3  # number of seeds that practise on the arm


def jobs(seeds: Sequence[int], rollouts: int) -> list[Job]:
    """Runs of both variants, execution of a learnt policy of each, and practice on the arm."""
    found = []
    for variant in VARIANTS:
        arguments = {"variant": variant, "seeds": list(seeds), "rollouts": rollouts}
        found.append(Job(TAUGHT, f"{variant}-{seeds[0]}-{seeds[-1]}", taught_runs, arguments))
        one = {"variant": variant, "seed": seeds[0], "rollouts": rollouts}
        found.append(Job(EXECUTED, variant, executed_run, one))
        for seed in seeds[:PRACTISING]:
            one = {"variant": variant, "seed": seed, "rollouts": min(rollouts, PRACTICE_MAX)}
            found.append(Job(PRACTISED, f"{variant}-{seed}", practised_run, one))
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
    shown = np.linspace(0, scenario.steps - 1, reaching_runs.PATH_SAMPLES).round().astype(int)
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


def practised_run(variant: str, seed: int, rollouts: int) -> dict[str, Any]:
    """Run PoWER with rollouts on the arm: Eq. 4 of executed paths, 0 after a fault.

    Returns:
        "returns" and number of "faults" of the rollouts, which do not include a reproduction;
        "return", "clearance" from the sphere [m] and "fault" of the executed final mean.
    """
    scenario = taught_scenario()
    parameters = parametrization_of(scenario.policy, variant, NOISE[variant])
    learner = Power(parameters.size, POWER, reaching_runs.generator(seed))
    environment = Environment(World(scene_type("flip"), seed=seed))

    def returned(z: np.ndarray, policy_id: str) -> tuple[np.ndarray, str, float]:
        path, fault = _executed(environment, parameters.policy(z, policy_id)[0], scenario)
        stopped, _ = scenario.stopped_paths(path[np.newaxis])
        return path, fault, 0.0 if fault else float(scenario.returns(stopped)[0])

    returns, faults = [], 0
    for k in range(rollouts):
        z = parameters.clip(learner.ask())
        _, fault, ret = returned(z, f"trial-{k}")
        learner.tell(z, ret)
        returns.append(ret)
        faults += bool(fault)
    path, fault, ret = returned(parameters.clip(learner.mean), "learnt")
    return {
        "variant": variant,
        "seed": seed,
        "returns": returns,
        "faults": faults,
        "return": ret,
        "clearance": _clearance(path, scenario),
        "fault": fault,
    }


def _clearance(path: np.ndarray, scenario: Scenario) -> float:
    """Least distance of a path (T, 3) from the surface of the sphere [m]."""
    return float(np.linalg.norm(path - scenario.obstacle, axis=1).min() - scenario.radius)


def _executed(
    environment: Environment, policy: Policy, scenario: Scenario
) -> tuple[np.ndarray, str]:
    """Path of the tool (T, 3) [m] at the samples of the scenario, and the fault or ""."""
    rollout, _ = environment.run(policy)
    t = np.arange(scenario.steps) * scenario.period
    path = [np.interp(t, rollout.tool.t, x) for x in rollout.tool.position.T]
    return np.stack(path, axis=1), "" if rollout.fault is None else rollout.fault.text


@cache
def taught_scenario() -> Scenario:
    """Scenario of the tool paths of the shipped demonstrations."""
    arm = Environment(World(scene_type("flip"), seed=NOISE_SEED)).arm
    bags = sorted(share("bags").glob("reach_*"))
    demonstrations = [from_joint_samples(arm, *read_demonstration(bag, JOINTS)) for bag in bags]
    return scenario_of(demonstrations)
