# SPDX-License-Identifier: Apache-2.0
"""Messages that motion captures, cameras and trackers send: of every type that is read.

`ros.body_sources` reads them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField

from wam_power_ros.ros.body_sources import TF_TYPE, Message, message_class
from wam_power_ros.ros.pose_messages import fill_pose
from wam_power_ros.ros.stamps import time_message

ELSEWHERE = (-1.0, 0.5, 0.2)  # [m] of the other bodies


def _fill_transform(message: Message, body: str, *pose: np.ndarray) -> None:
    message.child_frame_id, transform = body, message.transform
    place, o = transform.translation, transform.rotation
    place.x, place.y, place.z = map(float, pose[0])
    o.x, o.y, o.z, o.w = map(float, pose[1])


def _fill_tf(message: Message, body: str, *pose: np.ndarray) -> None:
    each = message_class("geometry_msgs/msg/TransformStamped")()
    _fill_transform(each, body, *pose)
    message.transforms = [each]


def _fill_array(message: Message, body: str, *pose: np.ndarray) -> None:
    message.poses = [message_class("geometry_msgs/msg/Pose")() for _ in range(int(body) + 2)]
    for each in message.poses:
        fill_pose(each, ELSEWHERE, pose[1])
    fill_pose(message.poses[int(body)], *pose)


def _fill_named(
    kind: str, items: str, name: str, message: Message, body: str, *pose: np.ndarray
) -> None:
    first, second = (message_class(kind)(**{name: each}) for each in ("another_body", body))
    fill_pose(first.pose, ELSEWHERE, pose[1])
    fill_pose(second.pose, *pose)
    setattr(message, items, [first, second])


def _fill_points(message: Message, _: str, points: np.ndarray) -> None:
    message.markers = [message_class("mocap4r2_msgs/msg/Marker")() for _ in points]
    for each, point in zip(message.markers, points.tolist(), strict=True):
        each.translation.x, each.translation.y, each.translation.z = point


def _fill_cloud(message: PointCloud2, _: str, points: np.ndarray) -> None:
    points = np.asarray(points, dtype="<f4").reshape(-1, 3)
    message.height, message.width, message.is_dense = 1, len(points), True
    message.point_step, message.row_step = 12, 12 * len(points)
    message.fields = [
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate("xyz")
    ]
    message.data = points.tobytes()


def _fill_inner(message: Message, _: str, *pose: np.ndarray) -> None:
    fill_pose(message.pose.pose, *pose)


# Type -> what puts a pose (position, quaternion xyzw) or markers of a body into a new message
FILLS: dict[str, Callable[..., None]] = {
    "geometry_msgs/msg/PoseStamped": lambda message, _, *pose: fill_pose(message.pose, *pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _fill_inner,
    "nav_msgs/msg/Odometry": _fill_inner,
    "geometry_msgs/msg/TransformStamped": _fill_transform,
    "geometry_msgs/msg/PoseArray": _fill_array,
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": partial(
        _fill_named, "motion_capture_tracking_interfaces/msg/NamedPose", "poses", "name"
    ),
    "mocap4r2_msgs/msg/RigidBodies": partial(
        _fill_named, "mocap4r2_msgs/msg/RigidBody", "rigidbodies", "rigid_body_name"
    ),
    TF_TYPE: _fill_tf,
    "sensor_msgs/msg/PointCloud2": _fill_cloud,
    "mocap4r2_msgs/msg/Markers": _fill_points,
}


def message(name: str, stamp_ns: int, frame: str, body: str, *measured: np.ndarray) -> Message:
    """Message of a type with the pose of a body, or markers, in a frame."""
    result = message_class(name)()
    FILLS[name](result, body, *measured)
    for each in result.transforms if name == TF_TYPE else [result]:
        each.header.stamp, each.header.frame_id = time_message(stamp_ns), frame
    return result
