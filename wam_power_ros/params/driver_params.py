# SPDX-License-Identifier: Apache-2.0
"""Parameters of the drivers that come with this package: tag camera, NatNet client, Franka."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import Self

from wam_power_ros.params.node_params import Names, Params

Address = Annotated[str, Field(pattern=r"^\d+\.\d+\.\d+\.\d+$", description="as 192.168.1.2")]
Port = Annotated[int, Field(ge=1, le=65_535)]


class TagCameraParams(Params):
    """Parameters of the node; the values are in config/tag_camera.yaml."""

    file = "tag_camera.yaml"

    body: str
    image_topic: str = Field(min_length=1)
    info_topic: str = Field(min_length=1)
    family: Literal["16h5", "25h9", "36h10", "36h11"]
    tags: tuple[int, ...] = Field(min_length=1, max_length=64)
    tag_size: float = Field(ge=0.005, le=2.0, description="in m: a print, up to a poster")
    tag_poses: tuple[float, ...] = Field(max_length=64 * 7)
    ball_radius: float = Field(ge=0.0, le=0.2, description="in m: 0 for tags")
    ball_hue: float = Field(ge=0.0, lt=360.0, description="in degrees")

    @model_validator(mode="after")
    def _one_pose_each(self) -> Self:
        poses = np.array(self.tag_poses)
        if len(poses) != 7 * len(self.tags) or len({*self.tags}) != len(self.tags):
            raise ValueError(
                f"tag_poses must be 7 numbers for each of tags {self.tags}, all unlike"
            )
        if np.abs(np.linalg.norm(poses.reshape(-1, 7)[:, 3:], axis=1) - 1.0).max() > 1e-3:
            raise ValueError(f"quaternions in tag_poses {self.tag_poses} must have length 1")
        return self


class NatNetClientParams(Params):
    """Parameters of the node; the values are in config/natnet_client.yaml."""

    file = "natnet_client.yaml"

    body: str
    server: Address
    local: Address
    multicast: bool
    group: Address
    command_port: Port
    data_port: Port
    frame: str


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


DRIVERS = TagCameraParams, FrankaDriverParams, NatNetClientParams
