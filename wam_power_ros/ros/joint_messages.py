# SPDX-License-Identifier: Apache-2.0
"""Joint states, torques and recorded movements <-> arrays, in the order of our joints.

Reading validates the whole message and raises `ValueError` naming the value and the rule; the
caller drops the message, counts it and warns. Stamps are `int` nanoseconds, all else SI.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from wam_power_ros.ros import pose_messages
from wam_power_ros.ros.stamps import checked_stamp, nanoseconds, time_message

COMMAND_TYPES = {
    "multiarray": Float64MultiArray,
    "joint_state": JointState,
    "trajectory": JointTrajectory,
    "pose": PoseStamped,
}
Command = Float64MultiArray | JointState | JointTrajectory | PoseStamped


class JointReading(NamedTuple):
    """One joint state, in the order of our joints."""

    stamp_ns: int
    q: np.ndarray  # (nj,) [rad]
    qd: np.ndarray | None  # (nj,) [rad/s], None when the driver sends none


class JointStateReader:
    """JointState -> arrays in the order of `joint_names`, matched by name, others ignored."""

    def __init__(self, joint_names: Sequence[str]) -> None:
        if not joint_names or len(set(joint_names)) != len(joint_names):
            raise ValueError(f"joint_names {list(joint_names)} must be distinct and not empty")
        self.joint_names = tuple(joint_names)
        self._last_names: list[str] | None = None
        # (nj,) indices of our joints in `_last_names`; None when these are our joints in our order
        self._index: np.ndarray | None = None

    def __call__(self, message: JointState) -> JointReading | None:
        """Read one message; None when it holds none of our joints (another device's).

        A ValueError if some of our joints are missing or doubled, or a length or value is wrong.
        """
        names = message.name
        if names != self._last_names:
            index = self.lookup(names)
            if index is None:
                return None
            same = np.array_equal(index, np.arange(len(names)))
            self._last_names, self._index = list(names), None if same else index
        q = _joint_values("position", message.position, len(names))
        qd = None
        if len(message.velocity):
            qd = _joint_values("velocity", message.velocity, len(names))
        return self.reading(nanoseconds(message.header.stamp), q, qd)

    def reading(self, stamp_ns: int, q: np.ndarray, qd: np.ndarray | None) -> JointReading:
        """Check and order the numbers of a message that has the joint names of the last one."""
        if self._index is not None:
            q = q[self._index]
            qd = None if qd is None else qd[self._index]
        if not _finite(q):
            raise ValueError(f"position {q.tolist()} must be finite")
        if qd is not None and not _finite(qd):
            if np.isinf(qd).any():
                raise ValueError(f"velocity {qd.tolist()} must be finite, NaN or left out")
            qd = None
        return JointReading(checked_stamp(stamp_ns), q, qd)

    def velocity(self, message: JointState) -> np.ndarray | None:
        """Velocities (nj,) [rad/s] of a separate topic; without names, values are in our order.

        None when the message holds none of our joints; a ValueError as for a joint state.
        """
        index = self.lookup(message.name) if message.name else slice(None)
        if index is None:
            return None
        size = len(message.name) or len(self.joint_names)
        qd = _joint_values("velocity", message.velocity, size)[index]
        if not np.isfinite(qd).all():
            raise ValueError(f"velocity {qd.tolist()} must be finite")
        return qd

    def lookup(self, names: Sequence[str]) -> np.ndarray | None:
        """Indices of our joints in `names` (nj,), None if it has none; raises like `__call__`."""
        place = {name: i for i, name in enumerate(names)}
        missing = [name for name in self.joint_names if name not in place]
        if len(missing) == len(self.joint_names):
            return None
        if missing:
            raise ValueError(f"joints {missing} missing in names {list(names)}")
        if len(place) != len(names):
            raise ValueError(f"names {list(names)} must be distinct: restart their broadcaster")
        return np.array([place[name] for name in self.joint_names], dtype=np.intp)


def _finite(values: np.ndarray) -> bool:
    """Return True if every value is finite; a sum of floats is several times faster than NumPy."""
    return math.isfinite(sum(values.tolist())) or bool(np.isfinite(values).all())


def _joint_values(field: str, values: array, length: int) -> np.ndarray:
    if len(values) != length:
        raise ValueError(f"{field} has {len(values)} values for {length} joints")
    return np.frombuffer(values) if isinstance(values, array) else np.array(values, dtype=float)


class JointStateWriter:
    """Arrays -> JointState; the same message object is filled every time."""

    def __init__(self, joint_names: Sequence[str]) -> None:
        self.joint_names = tuple(joint_names)
        self._message = JointState(name=list(joint_names))

    def __call__(
        self, stamp_ns: int, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, frame: str = ""
    ) -> JointState:
        """Fill the message: q (nj,) [rad], qd (nj,) [rad/s], tau (nj,) [N m]; each may be empty."""
        message, given = self._message, (q, qd, tau)
        message.header.stamp, message.header.frame_id = time_message(stamp_ns), frame
        values = (array("d", np.asarray(each, dtype=float).tobytes()) for each in given)
        message.position, message.velocity, message.effort = values
        return message


class JointMovement(NamedTuple):
    """Recorded joint movement to replay."""

    t: np.ndarray  # (N,) [s]
    q: np.ndarray  # (N, nj) [rad]


def movement(message: JointTrajectory, joint_names: Sequence[str]) -> JointMovement:
    """Read times and positions of a movement, matched by joint name.

    A ValueError if joints are missing or doubled, a length is wrong or a value not finite.
    """
    index = JointStateReader(joint_names).lookup(message.joint_names)
    if index is None or not message.points:
        raise ValueError(f"trajectory of {message.joint_names} has no point of {list(joint_names)}")
    size = len(message.joint_names)
    rows = [_joint_values("position", point.positions, size)[index] for point in message.points]
    q = np.array(rows)  # (N, nj)
    if not np.isfinite(q).all():
        raise ValueError("positions of the trajectory must be finite")
    times = [point.time_from_start for point in message.points]
    return JointMovement(np.array([time.sec + 1e-9 * time.nanosec for time in times]), q)


def movement_message(joint_names: Sequence[str], movement: JointMovement) -> JointTrajectory:
    """Movement as a trajectory message."""
    message = JointTrajectory(joint_names=list(joint_names))
    for t, q in zip(movement.t, movement.q, strict=True):
        point = JointTrajectoryPoint(positions=array("d", q))
        point.time_from_start = Duration(nanoseconds=round(float(t) * 1e9)).to_msg()
        message.points.append(point)
    return message


class TorqueReading(NamedTuple):
    """One command and the state it was computed from."""

    stamp_ns: int | None  # None when the sender does not label its commands
    label: str
    tau: np.ndarray  # (nj,) [N m] or [rad]; or a pose (7,), see `TorqueWriter`


@dataclass(frozen=True)
class TorqueWriter:
    """Torques or positions -> command message, labelled with the state they were computed from.

    A Float64MultiArray carries "<stamp_ns> <label>" in `layout.dim[0].label`, a JointTrajectory as
    frame_id, a JointState the stamp in its header and the label as frame_id. Real drivers read
    none of them. A PoseStamped has the stamp in its header, and as frame_id the base frame alone,
    which drivers compare; to a stand-in the label follows.
    """

    joint_names: Sequence[str]  # in the order of the commands
    command_type: str  # one of `COMMAND_TYPES`
    set_point_period: float = 0.0  # in which a position is to be reached [s]; 0 for torques
    frame: str = ""  # of the poses
    to_stand_in: bool = True  # poses are labelled

    @property
    def message_type(self) -> type[Command]:
        """Type of the messages."""
        return COMMAND_TYPES[self.command_type]

    def __call__(self, stamp_ns: int, label: str, tau: np.ndarray) -> Command:
        """Message with tau (nj,) [N m] or [rad], or a pose (7,)."""
        names, stamped = list(self.joint_names), f"{stamp_ns} {label}"
        if self.command_type == "joint_state":
            q, torques = (tau, ()) if self.set_point_period else ((), tau)
            return JointStateWriter(names)(stamp_ns, q, (), torques, frame=label)
        if self.command_type == "pose":
            frame = f"{self.frame} {label}" if self.to_stand_in else self.frame
            return pose_messages.pose_message(stamp_ns, frame, tau[:3], tau[3:])
        values = array("d", tau.tolist())
        if self.command_type == "trajectory":  # stamp 0: from its arrival on
            point = JointTrajectoryPoint(positions=values)
            point.time_from_start.nanosec = round(self.set_point_period * 1e9)
            message = JointTrajectory(joint_names=names, points=[point])
            message.header.frame_id = stamped
            return message
        dimension = MultiArrayDimension(label=stamped, size=len(names), stride=len(names))
        return Float64MultiArray(layout=MultiArrayLayout(dim=[dimension]), data=values)


def torque(message: Command, joint_names: Sequence[str], base_frame: str = "") -> TorqueReading:
    """Read a command as a driver does; the last point of a trajectory.

    A ValueError if length, names or the frame of a pose are wrong, or a value is not finite.
    """
    if isinstance(message, PoseStamped):
        frame, _, label = message.header.frame_id.partition(" ")
        if frame != base_frame:
            raise ValueError(f"pose in frame {frame!r}, not {base_frame!r}")
        reading = pose_messages.pose(message)
        pose = np.concatenate([reading.position, reading.quat_xyzw])
        return TorqueReading(reading.stamp_ns, label, pose)
    if isinstance(message, JointState):
        names, values = message.name, message.effort or message.position
        stamp_ns, label = nanoseconds(message.header.stamp) or None, message.header.frame_id
    else:
        if isinstance(message, JointTrajectory):
            names, stamped = message.joint_names, message.header.frame_id
            values = message.points[-1].positions if message.points else ()
        else:
            names, values = list(joint_names), message.data
            stamped = message.layout.dim[0].label if message.layout.dim else ""
        number, _, label = stamped.partition(" ")
        stamp_ns = int(number) if number.isascii() and number.isdigit() else None
    if names != list(joint_names):
        raise ValueError(f"names {names} must be {list(joint_names)}")
    tau = _joint_values("command", values, len(joint_names)).copy()
    if not np.isfinite(tau).all():
        raise ValueError(f"command {tau.tolist()} must be finite")
    return TorqueReading(stamp_ns, label, tau)
