# SPDX-License-Identifier: Apache-2.0
"""Parameters of the tracker node, which `check_driver` uses as well."""

from __future__ import annotations

import os
from importlib.util import find_spec
from typing import ClassVar, Literal, get_args

from pydantic import BaseModel, Field, model_validator
from typing_extensions import Self

from wam_power_ros.params.node_params import Params
from wam_power_ros.tracking.tracker import TrackerSettings

POSE, CLOUD = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/PointCloud2"
OfMarkers = Literal["sensor_msgs/msg/PointCloud2", "mocap4r2_msgs/msg/Markers"]
OfPose = Literal[
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/PoseArray",
    "nav_msgs/msg/Odometry",
    "motion_capture_tracking_interfaces/msg/NamedPoseArray",
    "mocap4r2_msgs/msg/RigidBodies",
    "tf2_msgs/msg/TFMessage",
]
MessageType = Literal["", OfPose, OfMarkers]
MESSAGE_TYPES: tuple[str, ...] = (*get_args(OfPose), *get_args(OfMarkers))


def missing_package(message_type: str) -> str:
    """Why messages of a type cannot be read here, with the remedy; empty if they can."""
    package = message_type.partition("/")[0]
    if find_spec(package):
        return ""
    apt = f"ros-{os.environ.get('ROS_DISTRO', 'jazzy')}-{package.replace('_', '-')}"
    text = f"{message_type} needs the package {package}: apt install {apt}"
    return f"{text}; without ROS pip install ./wam_power_interfaces has it"


class MocapTopics(BaseModel):
    """Topics, types and names by which a motion capture publishes a body; also of its stand-in."""

    body: str  # name of the tracked body
    pose_topic: str
    markers_topic: str
    message_type: MessageType
    body_in_message: str

    @property
    def pose_type(self) -> str:
        """Type of the messages on pose_topic."""
        return self.message_type if self.message_type in get_args(OfPose) else POSE

    @property
    def markers_type(self) -> str:
        """Type of the messages on markers_topic."""
        return self.message_type if self.message_type in get_args(OfMarkers) else CLOUD

    @property
    def source_body(self) -> str:
        """Name or index of the body in the messages."""
        own = "0" if self.message_type.endswith("/PoseArray") else self.body
        return self.body_in_message.replace("{body}", self.body) or own


class BodyTrackerParams(MocapTopics, Params, TrackerSettings):
    """Parameters of the node, settings of its tracker included.

    The values are in config/pancake_tracker.yaml.
    """

    file = "pancake_tracker.yaml"
    settable: ClassVar[set[str]] = {
        "latency_offset",
        "workspace_low",
        "workspace_high",
        "speed_max",
        "noise",
        "silence",
    }

    tethered: bool  # by a string, say: its falls do not tell whether the base frame is right
    base_frame: str
    mocap_frame: str = Field(min_length=1)
    silence: float = Field(
        ge=0.05, le=60.0, description="in s: above the period of 30 Hz, and at most a minute"
    )
    clock_offset_max: float = Field(
        ge=0.001, le=10.0, description="in s: above the jitter; a clock never set is farther off"
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if not self.body:
            return self
        if bool(self.pose_topic) == bool(self.markers_topic):
            raise ValueError(
                f"set either pose_topic or markers_topic, not {self.pose_topic!r} and "
                f"{self.markers_topic!r}"
            )
        topic = "markers_topic" if self.markers_topic else "pose_topic"
        allowed = get_args(OfMarkers if self.markers_topic else OfPose)
        if self.message_type not in ("", *allowed):
            text = f"message_type {self.message_type!r} is not one of {topic}"
            raise ValueError(f"{text}; allowed are {list(allowed)}")
        if self.message_type.endswith("/PoseArray") and not self.source_body.isdecimal():
            raise ValueError(
                f"body_in_message {self.body_in_message!r} must be the index of the pose: 0, 1, ..."
            )
        return self

    @property
    def topic(self) -> str:
        """Topic of the frames."""
        return self.markers_topic or self.pose_topic

    @property
    def source_type(self) -> str:
        """Type of the messages there."""
        return self.markers_type if self.markers_topic else self.pose_type
