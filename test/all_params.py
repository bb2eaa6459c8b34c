# SPDX-License-Identifier: Apache-2.0
"""The parameters of every node that has its own, by the name of the node."""

from __future__ import annotations

from pathlib import Path

from hardware_sim.settings import ArmSimParams, OptitrackSimParams
from wam_power_ros.nodes.demonstration_recorder import DemonstrationRecorderParams
from wam_power_ros.nodes.learner import LearnerParams
from wam_power_ros.params.body_tracker_params import BodyTrackerParams
from wam_power_ros.params.driver_params import DRIVERS
from wam_power_ros.params.node_params import Params
from wam_power_ros.params.torque_controller_params import TorqueControllerParams

_ALL: tuple[type[Params], ...] = (
    *(TorqueControllerParams, BodyTrackerParams, DemonstrationRecorderParams, LearnerParams),
    *DRIVERS,
    *(ArmSimParams, OptitrackSimParams),
)
READS = {Path(params.file).stem: params for params in _ALL}
