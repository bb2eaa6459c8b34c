# SPDX-License-Identifier: Apache-2.0
"""A reach without physics, for tests: Eq. 1 with noise, stopped at the obstacle."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from toss_task import AnyArm

from hardware_sim.wam import JOINTS
from reproduction.studies.reaching_scenario import Scenario, free_paths, midpoint
from wam_power_ros.bags.reader import read_demonstration
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.demonstration import from_joint_samples, from_positions
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import EndEffectorPath, Rollout
from wam_power_ros.params.resources import share
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.session_log import Trial
from wam_power_ros.practice.settings import preset
from wam_power_ros.regions import region_of
from wam_power_ros.tasks.reach.paths import STEPS, resampled, stopped_paths
from wam_power_ros.tasks.reach.task import Reach

START = np.array([0.7, -0.25, 0.6])  # [m] of the tool
NOISE = 0.003  # standard deviation of the end of a path, per axis [m]


def _demonstration() -> Any:  # noqa: ANN401
    s = np.linspace(0.0, 1.0, 450)[:, np.newaxis]
    s = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    arc = np.sin(np.pi * s) * [0.0, 0.0, 0.06]
    return from_positions(START + s * [0.01, 0.5, 0.0] + arc, 0.004)


_TAUGHT = _demonstration()
DEMONSTRATION = Reach.policy_of([_TAUGHT], "demonstration-1")
CONTEXT = Reach.context_of(
    [_TAUGHT], region_of("obstacle", [*midpoint(resampled([_TAUGHT])), 0.06])
)


def reached(task: Reach, trial: Trial) -> Rollout:
    """Rollout of a trial: a function of its id and policy alone."""
    policy = trial.policy
    path = free_paths(policy, START, policy.stiffness[None], policy.attractors[None])
    noise = np.random.default_rng(zlib.crc32(trial.id.encode())).normal(0.0, NOISE, 3)
    path += np.linspace(0.0, 1.0, STEPS)[:, np.newaxis] * noise
    stopped, touched = stopped_paths(path, np.array(task.region.centre), task.region.radius)
    t = np.arange(STEPS) * (policy.basis.duration / (STEPS - 1))
    t = np.append(t, policy.basis.duration + task.settle_time)
    position = np.vstack([stopped[0], stopped[0, -1:]])
    tool = EndEffectorPath(trial.id, t, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
    return Rollout(tool, None, None, "obstacle" if touched[0] else "")


def practised(policy: Policy, seed: int, context: Mapping[str, Any] = CONTEXT) -> Practice:
    """A finished session of the default preset."""
    practice = Practice(preset("reach"), context, [policy], seed, AnyArm())
    while (trial := practice.next_trial()) is not None:
        practice.learn(trial, reached(practice.task, trial))
    return practice


@cache
def taught_scenario() -> Scenario:
    """Scenario of the shipped demonstrations; it begins where the tool is at q_start."""
    arm = Arm(share("urdf/wam7.urdf").read_text(), JOINTS)
    bags = sorted(share("bags").glob("reach_*"))
    shown = [from_joint_samples(arm, *read_demonstration(bag, JOINTS)) for bag in bags]
    return Scenario(resampled(shown), Reach.policy_of(shown, "demonstration"), shown[0].position[0])
