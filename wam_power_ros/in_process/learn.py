# SPDX-License-Identifier: Apache-2.0
"""A session on disk, taught and practised in simulation without nodes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from wam_power_ros import installed
from wam_power_ros.arm_identity import refusal
from wam_power_ros.control.modes import ControllerError
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.policy import Policy
from wam_power_ros.params.overlay import Setup
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.practice.candidates import fitted
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import SessionSettings
from wam_power_ros.regions import Region


def run(
    folder: Path, setup: Setup, settings: SessionSettings, seed: int, demonstrations: int
) -> Iterator[Session]:
    """Begin or resume the session of a folder; yield it after each rollout, once that is on disk.

    Args:
        folder: Folder of the session.
        setup: Parameters by node, of stand-ins, controller and tracker.
        settings: Those of a session that is begun.
        seed: Seed of the simulated demonstrator and of the exploration.
        demonstrations: Number of demonstrations of a session that is begun.

    Raises:
        ValueError: No demonstration can be reproduced, or the session cannot be resumed, such as
            one of another arm.
    """
    environment = Environment.from_setup(setup)
    if Session.exists(folder):
        session = Session.open(folder)
        for policy in session.policies:
            if why := refusal(policy.arm, environment.arm.identity()):
                session.close()
                raise ValueError(f"{folder}: policy {policy.id} {why}")
    else:
        region = TorqueControllerParams.from_setup(setup).region
        candidates, context = _taught(environment, settings, region, seed, demonstrations)
        session = Session.begin(folder, settings, seed, candidates, context=context)
    with session:
        practice = session.practice(environment)
        if practice.best is not None:  # a killed session may have missed it
            session.save_policy(practice.best.policy)
        yield session
        for record in environment.practise(practice, setup["learner"]["scene_reset"]):
            session.append(record)
            if practice.best is not None:
                session.save_policy(practice.best.policy)
            yield session


def _taught(
    environment: Environment,
    settings: SessionSettings,
    region: Region | None,
    seed: int,
    count: int,
) -> tuple[list[Policy], dict[str, Any]]:
    """Feasible policies of demonstrations by the simulated demonstrator, and the task's context.

    Raises:
        ValueError: There is none; says why.
    """
    kind, arm, world = installed.task_type(settings.task), environment.arm, environment.world
    if kind.rated:
        raise ValueError(f"a person rates the task {kind.name}: learn it without --in-process")
    settings.check(count)
    read: dict[int, Demonstration] = {}
    refused = []
    for number in range(count):  # as the stand-in of a graph of nodes draws them
        script = world.scene.script(np.random.default_rng((seed, number)))
        try:
            recorded = environment.demonstrate(script, f"demonstration-{number}")
            read[number + 1] = kind.demonstration_of(arm, *recorded)
        except (ControllerError, ValueError) as error:
            refused.append(str(error))
    identity = arm.identity()
    candidates, why = fitted(kind, settings, read, environment, identity, region)
    refused += why.values()
    if not candidates:
        raise ValueError(f"no demonstration can be reproduced: {'; '.join(refused)}")
    used = [read[number] for group in candidates for number in group]
    return [*candidates.values()], kind.context_of(used, region)
