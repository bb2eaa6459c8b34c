# SPDX-License-Identifier: Apache-2.0
"""Parameters of the torque controller, and the controller made from them."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from wam_power_ros.control.arm import Arm, guarded_points
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.safety import limits_of
from wam_power_ros.params.node_params import Params

Positive = Annotated[float, Field(gt=0.0)]


class TorqueControllerParams(Params):
    """Parameters of config/torque_controller.yaml, where a comment explains each."""

    autostart: bool
    realtime_priority: int = Field(ge=0, le=98)
    hardware_id: str
    joint_names: Annotated[tuple[str, ...], Field(min_length=1)]
    model_joint_names: Annotated[tuple[str, ...], Field(min_length=1)]
    state_topic: str
    velocity_topic: str
    command_topic: str
    command_type: Literal["multiarray", "joint_state"]
    driver_compensates_gravity: bool
    hold_to_run: bool
    allow_no_realtime: bool
    idle_service: str
    urdf: str
    base_frame: str
    tool_frame: str
    period: Positive
    state_timeout: float = Field(ge=0.0)
    torque_share: float = Field(gt=0.0, le=1.0)
    torque_rate_max: Positive
    guarded_names: Annotated[tuple[str, ...], Field(min_length=1)]
    guarded_links: Annotated[tuple[str, ...], Field(min_length=1)]
    guarded_points: Annotated[tuple[float, ...], Field(min_length=1)]
    elbow_speed_max: Positive
    tool_speed_max: Positive
    teaching_tool_speed_max: Positive
    workspace_min: tuple[float, float, float]
    workspace_max: tuple[float, float, float]
    plane: tuple[float, float, float, float]
    obstacle: tuple[float, float, float, Annotated[float, Field(ge=0.0)]]
    law: Literal["operational_space", "virtual_mass"]
    move_speed: Positive
    start_tolerance: Positive
    settle_time: Positive
    stiffness_max: Positive
    damping_max: Positive
    contact_share: float = Field(gt=0.0, le=1.0)
    unexplained_share: float = Field(gt=0.0, le=1.0)
    velocity_cutoff: Positive

    def controller(self, urdf: str) -> Controller:
        """Make the controller for the arm of this URDF.

        Raises:
            ValueError: The URDF has not the arm that these parameters name.
        """
        if len(self.model_joint_names) != len(self.joint_names):
            raise ValueError(
                f"model_joint_names {self.model_joint_names} must be as many as joint_names"
            )
        guarded = guarded_points(self.guarded_names, self.guarded_links, self.guarded_points)
        arm = Arm(urdf, self.model_joint_names, self.tool_frame, guarded=guarded)
        limits = limits_of(
            arm,
            torque=self.torque_share * arm.tau_max,
            torque_rate=np.full(arm.n, self.torque_rate_max),
            elbow_speed=self.elbow_speed_max,
            tool_speed=self.tool_speed_max,
            teaching_tool_speed=self.teaching_tool_speed_max,
            workspace_min=self.workspace_min,
            workspace_max=self.workspace_max,
            plane=self.plane,
        )
        own = {field.name for field in dataclasses.fields(ControllerSettings)} - {"limits"}
        choices = {name: getattr(self, name) for name in own}
        return Controller(arm, ControllerSettings(limits=limits, **choices))
