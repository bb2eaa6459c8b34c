# SPDX-License-Identifier: Apache-2.0
"""Feasible policies that are fitted to demonstrations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from wam_power_ros.arm_identity import ArmIdentity
from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.learning_run import ArmModel
from wam_power_ros.practice.practice import reproduction_of
from wam_power_ros.practice.settings import SessionSettings
from wam_power_ros.regions import Region
from wam_power_ros.tasks.task import Task

Group = tuple[int, ...]  # numbers of the demonstrations of one policy


def fitted(
    kind: type[Task],
    settings: SessionSettings,
    read: Mapping[int, Demonstration],
    arm: ArmModel,
    identity: ArmIdentity,
    region: Region | None,
) -> tuple[dict[Group, Policy], dict[Group, str]]:
    """Policies of demonstrations by number, and why others are none; one policy if a task has one.

    A policy whose reproduction would end in a fault is none.
    """
    policies: dict[Group, Policy] = {}
    refused: dict[Group, str] = {}
    for group in [tuple(read)] if kind.single_policy and read else [(each,) for each in read]:
        movements = [read[number] for number in group]
        try:
            springs = settings.practice.springs
            policy = kind.policy_of(movements, f"demonstration-{group[0]}", springs)
            policy = replace(policy, arm=identity)
            task = settings.make_task(kind.context_of(movements, region))
            if fault := arm.infeasible(reproduction_of(policy, task)):
                raise ValueError(f"would end in a fault: {fault.text}")
            policies[group] = policy
        except ValueError as error:
            refused[group] = str(error)
    return policies, refused
