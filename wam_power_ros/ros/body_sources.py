# SPDX-License-Identifier: Apache-2.0
"""Messages of motion captures, cameras and trackers -> pose of one body, or its markers.

`SOURCES` has a reader for each type that the parameter `message_type` may name. Message packages
are imported when they are used: no robot has all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any, TypeAlias

import numpy as np
from rclpy.node import Node

from wam_power_ros import rotations
from wam_power_ros.params.body_tracker_params import BodyTrackerParams, missing_package
from wam_power_ros.ros import interface, pose_messages
from wam_power_ros.ros.pose_messages import MarkersReading, PoseReading
from wam_power_ros.tracking.frame_tree import FrameTree

TF_TYPE = "tf2_msgs/msg/TFMessage"
Reading = PoseReading | MarkersReading
Message: TypeAlias = Any  # of one of many types


def message_class(name: str) -> type:
    """Class of messages of a type; a ValueError says how to install its package."""
    if text := missing_package(name):
        raise ValueError(text)
    package, _, kind = name.split("/")
    return getattr(import_module(f"{package}.msg"), kind)


def _found(items: dict[str, Message], body: str) -> Message:
    if body not in items:
        raise ValueError(f"the message has no body {body!r}; it has {list(items)[:20]}")
    return items[body]


def _in_array(message: Message, body: str) -> PoseReading:
    poses = {str(number): pose for number, pose in enumerate(message.poses)}
    return pose_messages.reading(message, _found(poses, body))


def _in_list(items: str, name: str, message: Message, body: str) -> PoseReading:
    named = {getattr(each, name): each for each in getattr(message, items)}
    return pose_messages.reading(message, _found(named, body).pose)


def _in_tf(message: Message, body: str) -> PoseReading | None:
    for each in message.transforms:
        if bare(each.child_frame_id) == bare(body):
            return pose_messages.transform(each)
    return None


def _inner(message: Message, _: str) -> PoseReading:
    return pose_messages.reading(message, message.pose.pose)


def _points(message: Message, _: str) -> MarkersReading:
    places = [each.translation for each in message.markers]
    points = np.array([[it.x, it.y, it.z] for it in places]).reshape(-1, 3)
    return pose_messages.of_markers(message, points)


Read: TypeAlias = Callable[[Message, str], Reading | None]
# Type of message -> reading of one and the name or index of the body in it; None if /tf does not
# have it this time. A ValueError names what is wrong.
SOURCES: dict[str, Read] = {
    "geometry_msgs/msg/PoseStamped": lambda message, _: pose_messages.pose(message),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _inner,
    "nav_msgs/msg/Odometry": _inner,
    "geometry_msgs/msg/TransformStamped": lambda message, _: pose_messages.transform(message),
    "geometry_msgs/msg/PoseArray": _in_array,
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": partial(_in_list, "poses", "name"),
    "mocap4r2_msgs/msg/RigidBodies": partial(_in_list, "rigidbodies", "rigid_body_name"),
    TF_TYPE: _in_tf,
    "sensor_msgs/msg/PointCloud2": lambda message, _: pose_messages.markers(message),
    "mocap4r2_msgs/msg/Markers": _points,
}


def bare(frame: str) -> str:
    """Name of a frame as /tf has it, without a leading slash."""
    return frame.lstrip("/")


class BodySource:
    """The resolved `topic` of a body, or of markers: messages as arrays in the mocap_frame."""

    def __init__(self, node: Node, params: BodyTrackerParams) -> None:
        """Prepare to read; the caller subscribes. A ValueError names a missing package."""
        self.topic = node.resolve_topic_name(params.topic)
        self.kind = message_class(params.source_type)
        self._read = SOURCES[params.source_type]
        self._node, self._body = node, params.source_body
        self._frame = bare(params.mocap_frame)
        self._tree: FrameTree | None = None
        self._seen, self._others = False, set[str]()  # the body, and other frames before it, in /tf

    def read(self, message: Message) -> Reading | None:
        """Read a message; None if it does not concern the body.

        Raises:
            ValueError: The message is not valid or lacks the body, or its frame is neither empty
                nor the mocap_frame nor connected to it in /tf.
        """
        reading = self._read(message, self._body)
        if reading is None:
            if not self._seen:
                self._others.update(bare(each.child_frame_id) for each in message.transforms)
            return None
        self._seen = True
        if (frame := bare(reading.frame)) in ("", self._frame):
            return reading
        tree = self._tree = self._tree or self._listening()
        try:
            position, quat_xyzw = tree.pose(frame, self._frame, reading.stamp_ns)
        except ValueError as error:
            raise ValueError(f"frame_id is not mocap_frame, and by /tf {error}") from None
        rotation = rotations.matrix(quat_xyzw)
        if isinstance(reading, MarkersReading):
            points = reading.points @ rotation.T + position
            return MarkersReading(reading.stamp_ns, self._frame, points)
        placed = position + rotation @ reading.position
        turned = rotations.multiply(quat_xyzw, reading.quat_xyzw)
        return PoseReading(reading.stamp_ns, self._frame, placed, turned)

    @property
    def missing(self) -> str:
        """What is in /tf instead of the body, as a sentence; empty if it was there, or nothing."""
        if self._seen or not self._others:
            return ""
        return f"/tf has no frame {self._body!r}; it has {sorted(self._others)[:30]}"

    def _listening(self) -> FrameTree:
        """Tree of frames, filled from now on."""
        tree, kind = FrameTree(), message_class(TF_TYPE)

        def add(fixed: bool, message: Message) -> None:
            for each in message.transforms:
                child, parent = bare(each.child_frame_id), bare(each.header.frame_id)
                try:
                    pose = pose_messages.transform(each, stamped=not fixed)
                except ValueError as error:
                    text = f"pose of frame {child!r} in /tf refused: {error}"
                    self._node.get_logger().warning(text, throttle_duration_sec=5.0)
                    continue
                tree.add(child, parent, pose.stamp_ns, (pose.position, pose.quat_xyzw), fixed)

        subscribe, moving = self._node.create_subscription, interface.MOCAP_BEST_EFFORT
        subscribe(kind, interface.TF, partial(add, False), moving)
        subscribe(kind, interface.TF_STATIC, partial(add, True), interface.FIXED)
        return tree
