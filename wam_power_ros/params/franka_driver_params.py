# SPDX-License-Identifier: Apache-2.0
"""Parameters of the driver of a Franka robot."""

from __future__ import annotations

from pydantic import Field, model_validator
from typing_extensions import Self

from wam_power_ros.params.node_params import Names, Params


class FrankaDriverParams(Params):
    """Parameters of the node; the values are in config/franka_driver.yaml."""

    file = "franka_driver.yaml"

    address: str
    joint_names: Names
    state_topic: str = Field(min_length=1)
    command_topic: str = Field(min_length=1)
    period: float = Field(ge=0.001, le=0.005, description="in s: the robot's is 0.001")
    watchdog: float = Field(ge=0.005, le=0.02, description="in s: of every driver at most 0.02")
    collision_torque: float = Field(ge=5.0, le=100.0, description="in N m: 100 is no protection")
    collision_force: float = Field(ge=5.0, le=200.0, description="in N")
    realtime_priority: int = Field(ge=0, le=98, description="99 is reserved for kernel threads")

    @model_validator(mode="after")
    def _of_a_franka(self) -> Self:
        if self.address and len(self.joint_names) != 7:
            raise ValueError(f"joint_names {self.joint_names} must be the robot's 7, base to tip")
        return self
