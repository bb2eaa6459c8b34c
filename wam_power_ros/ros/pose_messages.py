# SPDX-License-Identifier: Apache-2.0
"""Poses, markers, states and paths <-> arrays.

Reading validates the whole message and raises `ValueError` naming the value and the rule. Stamps
are `int` nanoseconds, quaternions xyzw, all else SI.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import KeyValue
from geometry_msgs.msg import PoseStamped, TransformStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import PointCloud2, PointField

from wam_power_interfaces.msg import GroundTruth
from wam_power_ros import plain_json, rotations
from wam_power_ros.ros.stamps import nanoseconds, sensor_stamp, time_message

if TYPE_CHECKING:
    from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath


class PoseReading(NamedTuple):
    """One motion-capture pose."""

    stamp_ns: int
    frame: str
    position: np.ndarray  # (3,) [m]
    quat_xyzw: np.ndarray  # (4,)


class MarkersReading(NamedTuple):
    """Unlabelled markers; one that is not finite is left out."""

    stamp_ns: int
    frame: str
    points: np.ndarray  # (m, 3) [m]


def fill_pose(pose: object, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
    """Set position (3,) [m] and quat_xyzw (4,) of a Pose."""
    p, o = pose.position, pose.orientation
    p.x, p.y, p.z = (float(value) for value in position)
    o.x, o.y, o.z, o.w = (float(value) for value in quat_xyzw)


def _arrays(p: Any, o: Any) -> tuple[np.ndarray, np.ndarray]:  # noqa: ANN401 - of messages
    return np.array([p.x, p.y, p.z]), np.array([o.x, o.y, o.z, o.w])


def pose_message(
    stamp_ns: int, frame: str, position: np.ndarray, quat_xyzw: np.ndarray
) -> PoseStamped:
    """Message of a pose: position (3,) [m] and quat_xyzw (4,), in `frame`."""
    message = PoseStamped()
    message.header.stamp, message.header.frame_id = time_message(stamp_ns), frame
    fill_pose(message.pose, position, quat_xyzw)
    return message


def pose(message: PoseStamped) -> PoseReading:
    """Read a pose, see `reading`."""
    return reading(message, message.pose)


def reading(message: object, pose: object) -> PoseReading:
    """Read a Pose in a message with a header; the quaternion comes back normalised.

    A ValueError if the stamp is not set, a value is not finite, or the quaternion is not of unit
    length (1e-3).
    """
    return _checked(message, sensor_stamp(message), *_arrays(pose.position, pose.orientation))


def transform(message: TransformStamped, stamped: bool = True) -> PoseReading:
    """Read the pose of the child frame, see `reading`; static ones need no stamp."""
    stamp_ns = sensor_stamp(message) if stamped else nanoseconds(message.header.stamp)
    arrays = _arrays(message.transform.translation, message.transform.rotation)
    return _checked(message, stamp_ns, *arrays)


def _checked(
    message: object, stamp_ns: int, position: np.ndarray, quat_xyzw: np.ndarray
) -> PoseReading:
    if not (np.isfinite(position).all() and np.isfinite(quat_xyzw).all()):
        raise ValueError(f"pose not finite: {position.tolist()} {quat_xyzw.tolist()}")
    norm = float(np.linalg.norm(quat_xyzw))
    if abs(norm - 1.0) > 1e-3:
        raise ValueError(f"quaternion not of unit length: {quat_xyzw.tolist()} has {norm:.4g}")
    return PoseReading(stamp_ns, message.header.frame_id, position, quat_xyzw / norm)


def markers(message: PointCloud2) -> MarkersReading:
    """Read unlabelled markers.

    A ValueError if the stamp is not set, float32 x, y or z is missing, or a length is wrong.
    """
    fields = {field.name: field for field in message.fields}
    for name in "xyz":
        if name not in fields or fields[name].datatype != PointField.FLOAT32:
            raise ValueError(f"point cloud fields {sorted(fields)} must hold float32 x, y and z")
    formats = [(">" if message.is_bigendian else "<") + "f4"] * 3
    layout = {"names": list("xyz"), "formats": formats, "itemsize": message.point_step}
    layout["offsets"] = [fields[name].offset for name in "xyz"]
    cloud = np.frombuffer(bytes(message.data), dtype=np.dtype(layout))
    points = np.column_stack([cloud[name] for name in "xyz"]).astype(float)  # (m, 3)
    return of_markers(message, points)


def of_markers(message: object, points: np.ndarray) -> MarkersReading:
    """Markers at points (m, 3) [m] in a message with a header, see `markers`."""
    finite = np.isfinite(points).all(axis=1)
    return MarkersReading(sensor_stamp(message), message.header.frame_id, points[finite])


class StateReading(NamedTuple):
    """State of a rigid body, in the frame of the pose."""

    stamp_ns: int
    frame: str
    position: np.ndarray  # (3,) [m]
    quat_xyzw: np.ndarray  # (4,)
    velocity: np.ndarray  # (3,) [m/s]
    angular_velocity: np.ndarray  # (3,) [rad/s]
    variance: float  # position variance along each axis [m^2]


def odometry_message(state: StateReading, child_frame: str) -> Odometry:
    """State as Odometry, whose twist is rotated into the child frame."""
    message = Odometry(child_frame_id=child_frame)
    message.header.stamp, message.header.frame_id = time_message(state.stamp_ns), state.frame
    fill_pose(message.pose.pose, state.position, state.quat_xyzw)
    rotation = rotations.matrix(state.quat_xyzw)
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    linear.x, linear.y, linear.z = (rotation.T @ state.velocity).tolist()
    angular.x, angular.y, angular.z = (rotation.T @ state.angular_velocity).tolist()
    message.pose.covariance[0] = float(state.variance)
    message.pose.covariance[7] = message.pose.covariance[14] = message.pose.covariance[0]
    return message


def odometry(message: Odometry) -> StateReading:
    """Read a state, its twist rotated into the frame of the pose; a ValueError as for `reading`."""
    placed = reading(message, message.pose.pose)
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    twist = np.array([[linear.x, linear.y, linear.z], [angular.x, angular.y, angular.z]])
    if not np.isfinite(twist).all():
        raise ValueError(f"twist {twist.tolist()} must be finite")
    velocity, angular_velocity = twist @ rotations.matrix(placed.quat_xyzw).T
    variance = float(message.pose.covariance[0])
    return StateReading(*placed, velocity, angular_velocity, variance)


class PathReading(NamedTuple):
    """Path of a tool or a body through a rollout."""

    start_ns: int  # stamp of the start, which identifies the rollout
    t: np.ndarray  # (M,), time since the start [s]
    position: np.ndarray  # (M, 3) [m]
    quat_xyzw: np.ndarray  # (M, 4)


def path_message(path: EndEffectorPath | BodyPath, start_ns: int, frame: str) -> Path:
    """Message of a rollout's path in a frame, with the start of the rollout [ns] as its stamp."""
    message = Path()
    message.header.stamp, message.header.frame_id = time_message(start_ns), frame
    stamps = start_ns + np.rint(np.asarray(path.t) * 1e9).astype(np.int64)  # (M,) [ns]
    message.poses = [
        pose_message(int(time), frame, position, quat_xyzw)
        for time, position, quat_xyzw in zip(stamps, path.position, path.quat_xyzw, strict=True)
    ]
    return message


def path(message: Path) -> PathReading:
    """Read a rollout's path; its values are checked by `EndEffectorPath` and `BodyPath`.

    A ValueError if the stamp is not set, or those of the poses do not increase.
    """
    start_ns = sensor_stamp(message)
    t = np.array([(nanoseconds(item.header.stamp) - start_ns) * 1e-9 for item in message.poses])
    if np.any(np.diff(t) <= 0.0):
        raise ValueError("stamps of the poses of a path must increase")
    arrays = [_arrays(item.pose.position, item.pose.orientation) for item in message.poses]
    position = np.array([item[0] for item in arrays]).reshape(-1, 3)  # (M, 3)
    quat_xyzw = np.array([item[1] for item in arrays]).reshape(-1, 4)  # (M, 4)
    return PathReading(start_ns, t, position, quat_xyzw)


class TruthReading(NamedTuple):
    """What a simulator knows of a rollout that has ended there."""

    policy_id: str
    end_ns: int  # stamp of its end
    values: dict[str, Any]  # of the scene


def ground_truth_message(truth: TruthReading) -> GroundTruth:
    """Message about the ground truth of a rollout."""
    message = GroundTruth(policy_id=truth.policy_id)
    message.header.stamp = time_message(truth.end_ns)
    texts = {key: json.dumps(value) for key, value in truth.values.items()}
    message.values = [KeyValue(key=key, value=text) for key, text in texts.items()]
    return message


def ground_truth(message: GroundTruth) -> TruthReading:
    """Read the ground truth of a rollout; a ValueError if a value is not JSON."""
    what = "a value of the ground truth"
    values = {each.key: plain_json.parse(each.value, what) for each in message.values}
    return TruthReading(message.policy_id, nanoseconds(message.header.stamp), values)
