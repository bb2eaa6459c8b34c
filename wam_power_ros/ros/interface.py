# SPDX-License-Identifier: Apache-2.0
"""Names, QoS and message <-> array conversion: the ROS edge is here and nowhere else.

Every conversion out of a message validates it whole and raises `ValueError` naming the value and
the rule; a caller at the edge drops the message, counts it and warns. Stamps are `int` nanoseconds,
quaternions xyzw, all else SI.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from wam_power_ros.ros.pose_messages import PoseReading as PoseReading
from wam_power_ros.ros.pose_messages import StateReading as StateReading
from wam_power_ros.ros.pose_messages import diagnostics as diagnostics
from wam_power_ros.ros.pose_messages import markers as markers
from wam_power_ros.ros.pose_messages import markers_message as markers_message
from wam_power_ros.ros.pose_messages import nanoseconds as nanoseconds
from wam_power_ros.ros.pose_messages import odometry as odometry
from wam_power_ros.ros.pose_messages import odometry_message as odometry_message
from wam_power_ros.ros.pose_messages import path as path
from wam_power_ros.ros.pose_messages import path_message as path_message
from wam_power_ros.ros.pose_messages import pose as pose
from wam_power_ros.ros.pose_messages import pose_message as pose_message
from wam_power_ros.ros.pose_messages import sensor_stamp as sensor_stamp
from wam_power_ros.ros.pose_messages import set_stamp as set_stamp
from wam_power_ros.ros.pose_messages import stamp as stamp

# Topics
JOINT_STATES = "/joint_states"
EFFORT_COMMANDS = "/effort_controller/commands"
MARKERS = "/pointCloud"
POLICY = "/policy"
REPLAY_TRAJECTORY = "/replay/trajectory"
ROLLOUT_END_EFFECTOR = "/rollout/end_effector"
LEARNER_BAG = "/learner/bag"  # path of a demonstration to be given to the learner
ROBOT_DESCRIPTION = "/robot_description"
DIAGNOSTICS = "/diagnostics"
CLOCK = "/clock"
ENABLE = "/controller/enable"

# Services
EXECUTE = "/rollout/execute"
STOP = "/controller/stop"
RESET = "/controller/reset"
MOVE_TO_START = "/controller/move_to_start"
REPLAY = "/controller/replay"
GRAVITY_COMPENSATION = "/controller/gravity_compensation"
RECORD = "/recorder/record"
LEARNER_REWARD = "/learner/reward"
LEARNER_PUNISH = "/learner/punish"
LEARNER_DEMONSTRATION = "/learner/demonstration"
LEARNER_PAUSE = "/learner/pause"
WAM_GRAVITY_COMPENSATE = "/wam/gravityCompensate"
WAM_HOLD = "/wam/holdJointPosition"
WAM_MOVE_HOME = "/wam/moveHome"
WAM_IDLE = "/wam/idle"
DEMONSTRATE = "/demonstrator/demonstrate"  # stand-in only

NO_BAG = f"no bag was named on {LEARNER_BAG}"  # yet: topics and services are not ordered

# Topics and services of a tracked body, which follow its name; its frame is the name itself
BODY_LEAVES = ("pose", "state", "truth", "reset", "drop")  # the last three: stand-in only
SCENE_LEAVES = ("truth", "reset")  # of a task without a body
SCENE = "scene"
_BODY = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_RESERVED = {SCENE, "end_effector"}


def body_topic(body: str, leaf: str) -> str:
    """Topic or service of a tracked body, such as `/pancake/state`.

    Args:
        body: Name of the body; empty for a task without one, which has `/scene/truth` and
            `/scene/reset`.
        leaf: One of `BODY_LEAVES`.

    Raises:
        ValueError: When there is no such topic, or the name of the body is not acceptable.
    """
    leaves = BODY_LEAVES if body else SCENE_LEAVES
    if leaf not in leaves:
        raise ValueError(f"no topic {leaf!r} of body {body!r}; there are {list(leaves)}")
    return f"/{_checked(body) if body else SCENE}/{leaf}"


def rollout_topic(body: str) -> str:
    """Topic of a tracked body's path through a rollout, such as `/rollout/pancake`.

    Raises:
        ValueError: When the name of the body is not acceptable.
    """
    return f"/rollout/{_checked(body)}"


def _checked(body: str) -> str:
    if not _BODY.fullmatch(body) or body in _RESERVED:
        raise ValueError(
            f"name {body!r} of a tracked body must be letters, digits and underscores, begin with "
            f"a letter, and be none of {sorted(_RESERVED)}"
        )
    return body


# Frames
BASE_FRAME = "wam_base"
MOCAP_FRAME = "world"


def _qos(depth: int, reliability: str = "RELIABLE", durability: str = "VOLATILE") -> QoSProfile:
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy[reliability],
        durability=DurabilityPolicy[durability],
    )


# QoS: publish reliable, subscribe best effort, except what is latched
STATE_OUT = _qos(10)
# Of the stand-in, whose states may come in a row: in lockstep, and when it catches up with its
# clock. A recorder that could not run for seconds is sent again what it has missed.
STATE_OUT_DEEP = _qos(4000)
STATE_IN = _qos(10, "BEST_EFFORT")
STATE_RECORD = _qos(4000, "BEST_AVAILABLE")  # a recorder may fall behind, it may not lose
COMMAND = _qos(1)
MOCAP_OUT = _qos(10)
MOCAP_OUT_BEST_EFFORT = _qos(10, "BEST_EFFORT")  # of some drivers
MOCAP_IN = _qos(500, "BEST_EFFORT")  # every frame counts for a path: a burst pushes none out
LATCHED = _qos(1, durability="TRANSIENT_LOCAL")
DIAGNOSTICS_QOS = _qos(10)
CLOCK_QOS = _qos(1, "BEST_EFFORT")
ENABLE_OUT, ENABLE_IN = _qos(1), _qos(1, "BEST_EFFORT")
# A request to idle that a cut network has kept back would drop an arm that is carried again.
IDLE_QOS = _qos(1)
IDLE_QOS.lifespan = Duration(seconds=0.2)


# Joint states


class JointReading(NamedTuple):
    """One joint state, in the order of our joints."""

    stamp_ns: int
    q: np.ndarray  # (nj,) [rad]
    qd: np.ndarray | None  # (nj,) [rad/s], None when the driver does not say


class JointStateReader:
    """JointState -> arrays in the order of `joint_names`, matched by name, others ignored."""

    def __init__(self, joint_names: Sequence[str]) -> None:
        if not joint_names or len(set(joint_names)) != len(joint_names):
            raise ValueError(f"joint_names {list(joint_names)} must be distinct and not empty")
        self.joint_names = tuple(joint_names)
        self._seen: list[str] | None = None  # names of the last good message
        # (nj,) our joints in that message; None when it holds them and no others, in our order
        self._index: np.ndarray | None = None

    def __call__(self, message: JointState) -> JointReading | None:
        """Read one message.

        Returns:
            The reading, or None when the message holds none of our joints (another device's).

        Raises:
            ValueError: some of our joints missing or doubled, a length or a value not acceptable.
        """
        names = message.name
        if names != self._seen:
            index = self.lookup(names)
            if index is None:
                return None
            same = np.array_equal(index, np.arange(len(names)))
            self._seen, self._index = list(names), None if same else index
        q = _joint_values("position", message.position, len(names))
        qd = None
        if len(message.velocity):
            qd = _joint_values("velocity", message.velocity, len(names))
        return self.reading(nanoseconds(message.header.stamp), q, qd)

    def reading(self, stamp_ns: int, q: np.ndarray, qd: np.ndarray | None) -> JointReading:
        """A reading from the numbers of a message with the names of the last one.

        Raises:
            ValueError: a value not acceptable.
        """
        if self._index is not None:
            q = q[self._index]
            qd = None if qd is None else qd[self._index]
        if not _finite(q):
            raise ValueError(f"position {q.tolist()} must be finite")
        if qd is not None and not _finite(qd):
            if np.isinf(qd).any():
                raise ValueError(f"velocity {qd.tolist()} must be finite, NaN or left out")
            qd = None
        return JointReading(set_stamp(stamp_ns), q, qd)

    def velocity(self, message: JointState) -> np.ndarray | None:
        """Joint velocities from a message of their own; nameless ones count in our order.

        Returns:
            Velocities (nj,) [rad/s], or None when the message holds none of our joints.

        Raises:
            ValueError: as for a joint state.
        """
        names = message.name
        if not names:
            qd = _joint_values("velocity", message.velocity, len(self.joint_names))
        else:
            index = self.lookup(names)
            if index is None:
                return None
            qd = _joint_values("velocity", message.velocity, len(names))[index]
        if not np.isfinite(qd).all():
            raise ValueError(f"velocity {qd.tolist()} must be finite")
        return qd

    def lookup(self, names: Sequence[str]) -> np.ndarray | None:
        """Where our joints are in `names` (nj,), None when none is; ValueError as for a message."""
        place = {name: i for i, name in enumerate(names)}
        missing = [name for name in self.joint_names if name not in place]
        if len(missing) == len(self.joint_names):
            return None
        if missing:
            raise ValueError(f"joints {missing} missing in names {list(names)}")
        if len(place) != len(names):
            raise ValueError(f"names {list(names)} must be distinct")
        return np.array([place[name] for name in self.joint_names], dtype=np.intp)


def _finite(values: np.ndarray) -> bool:
    """Whether all are finite; a sum of floats tells it several times faster than NumPy does."""
    return math.isfinite(sum(values.tolist())) or bool(np.isfinite(values).all())


def _joint_values(field: str, values: array, length: int) -> np.ndarray:
    if len(values) != length:
        raise ValueError(f"{field} has {len(values)} values for {length} joints")
    return np.frombuffer(values) if isinstance(values, array) else np.array(values, dtype=float)


class JointStateWriter:
    """Arrays -> JointState; one message is made once and filled again and again."""

    def __init__(self, joint_names: Sequence[str]) -> None:
        self.joint_names = tuple(joint_names)
        self._message = JointState(name=list(joint_names))

    def __call__(
        self, stamp_ns: int, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, frame: str = ""
    ) -> JointState:
        """Fill the message: q (nj,) [rad], qd (nj,) [rad/s], tau (nj,) [N m]; empty leaves out."""
        message = self._message
        message.header.stamp = stamp(stamp_ns)
        message.header.frame_id = frame
        message.position = array("d", _plain(q))
        message.velocity = array("d", _plain(qd))
        message.effort = array("d", _plain(tau))
        return message


def nameless_velocities(stamp_ns: int, qd: np.ndarray) -> JointState:
    """Velocities (nj,) [rad/s] and nothing else, in an order that is agreed upon."""
    message = JointState(velocity=array("d", qd))
    message.header.stamp = stamp(stamp_ns)
    return message


def _plain(values: np.ndarray | Sequence[float]) -> Sequence[float]:
    return values.tolist() if isinstance(values, np.ndarray) else values


class JointMovement(NamedTuple):
    """A recorded joint movement, to be replayed."""

    t: np.ndarray  # (N,) [s]
    q: np.ndarray  # (N, nj) [rad]


def joint_movement(message: JointTrajectory, joint_names: Sequence[str]) -> JointMovement:
    """Read a movement; only its times and positions count, matched by name.

    Raises:
        ValueError: a joint missing or doubled, a length that does not fit, a value not finite.
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


def joint_movement_message(joint_names: Sequence[str], movement: JointMovement) -> JointTrajectory:
    """A movement as a trajectory message."""
    message = JointTrajectory(joint_names=list(joint_names))
    for t, q in zip(movement.t, movement.q, strict=True):
        sec, nanosec = divmod(round(float(t) * 1e9), 1_000_000_000)
        point = JointTrajectoryPoint(positions=array("d", q))
        point.time_from_start.sec, point.time_from_start.nanosec = sec, nanosec
        message.points.append(point)
    return message


# Torques


class TorqueReading(NamedTuple):
    """One torque command and the state it answers."""

    stamp_ns: int | None  # None when the sender does not label its commands
    label: str
    tau: np.ndarray  # (nj,) [N m]


class TorqueWriter:
    """Torques -> command message, labelled in-band with the state they answer.

    A Float64MultiArray carries "<stamp_ns> <label>" in `layout.dim[0].label`, a JointState the
    stamp in its header and the label as frame_id. Real drivers read neither.
    """

    def __init__(self, joint_names: Sequence[str], command_type: str) -> None:
        if command_type not in COMMAND_TYPES:
            raise ValueError(f"command_type {command_type!r} must be one of {list(COMMAND_TYPES)}")
        self.message_type = COMMAND_TYPES[command_type]
        self._states = JointStateWriter(joint_names) if command_type == "joint_state" else None
        size = len(joint_names)
        self._dimension = MultiArrayDimension(size=size, stride=size)
        self._message = Float64MultiArray()
        self._message.layout.dim = [self._dimension]

    def __call__(
        self, stamp_ns: int, label: str, tau: np.ndarray
    ) -> Float64MultiArray | JointState:
        """Fill the message with tau (nj,) [N m]; it is the same object every time."""
        if self._states is not None:
            return self._states(stamp_ns, (), (), tau, frame=label)
        self._dimension.label = f"{stamp_ns} {label}"
        self._message.data = array("d", tau.tolist())
        return self._message


COMMAND_TYPES = {"multiarray": Float64MultiArray, "joint_state": JointState}


def torque(message: Float64MultiArray | JointState, joint_names: Sequence[str]) -> TorqueReading:
    """Read a torque command as a driver does.

    Raises:
        ValueError: wrong length or names, or a value that is not finite.
    """
    if isinstance(message, JointState):
        if message.name != list(joint_names):
            raise ValueError(f"names {message.name} must be {list(joint_names)}")
        values, label = message.effort, message.header.frame_id
        answered = nanoseconds(message.header.stamp) or None
    else:
        values = message.data
        number, _, label = (message.layout.dim[0].label if message.layout.dim else "").partition(
            " "
        )
        answered = int(number) if number.isascii() and number.isdigit() else None
    tau = _joint_values("torque", values, len(joint_names)).copy()
    if not np.isfinite(tau).all():
        raise ValueError(f"torque {tau.tolist()} must be finite")
    return TorqueReading(answered, label, tau)
