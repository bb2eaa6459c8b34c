# SPDX-License-Identifier: Apache-2.0
"""Rigid-body model of the arm: kinematics and dynamics of a chain of joints, by Pinocchio.

An `Arm` reuses its buffers, so it belongs to one thread; every array it returns is a copy.
Pinocchio's results are read through NumPy views of its buffers that are created once: creating
them at every call would cost more than the computation.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from typing import NamedTuple, NoReturn
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from wam_power_ros import compiled
from wam_power_ros.arm_identity import ArmIdentity
from wam_power_ros.control.corrections import Corrections
from wam_power_ros.control.urdf_checks import (
    approach,
    limited,
    number,
    parsed,
    require_physical,
    require_usable,
    soft_limits,
)
from wam_power_ros.learning.policy import read_only

JOINTS_MAX = 64  # of a chain: the compiled loops have room for no more
FRICTION_SPEED = 0.02  # [rad/s] width of the tanh that smooths Coulomb friction at standstill
STRIBECK_SPEED = 0.05  # [rad/s] at which friction at low speed has fallen by a factor of e
_LINK = pin.FrameType.BODY
_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED  # origin of the tool, axes of the base


class GuardedPoint(NamedTuple):
    """A point of the arm, in addition to the tool, whose speed and position are limited.

    Attributes:
        offset: Position in the frame of the link [m]. Shape (3,).
    """

    name: str
    link: str
    offset: Sequence[float]


# Points whose speed the Barrett WAM's safety board limits: elbow, and 350 mm along the forearm.
WAM_GUARDED_POINTS = (
    GuardedPoint("elbow", "wam_link4", (0.0, 0.0, 0.0)),
    GuardedPoint("forearm", "wam_link4", (-0.045, -0.35, 0.0)),
)


def guarded_points(
    names: Sequence[str], links: Sequence[str], offsets: Sequence[float]
) -> tuple[GuardedPoint, ...]:
    """Build the guarded points from parameters; one name "" means none: ROS has no empty lists.

    Raises:
        ValueError: The numbers of names, links and offsets, three numbers a point, do not match.
    """
    if tuple(names) == ("",):
        return ()
    if not len(names) == len(links) == len(offsets) / 3:
        raise ValueError(
            f"guarded_points {offsets} must be three numbers, and guarded_links {links} one link, "
            f"for each of guarded_names {names}"
        )
    points = [tuple(offsets[i : i + 3]) for i in range(0, len(offsets), 3)]
    return tuple(GuardedPoint(*row) for row in zip(names, links, points, strict=True))


class Motion(NamedTuple):
    """Kinematic state of the tool and the guarded points, in the base frame.

    Attributes:
        position: Position of the tool frame's origin [m]. Shape (3,).
        rotation: Tool axes as columns. Shape (3, 3).
        twist: Linear velocity [m/s] and angular velocity [rad/s]. Shape (6,).
        drift: Jdot qd, the tool's acceleration at zero joint acceleration [m/s^2, rad/s^2].
            Shape (6,).
        guarded_positions: Positions of the guarded points [m], three numbers each.
        guarded_speeds: Speeds of the guarded points [m/s].
        tool_speed: Speed of the tool [m/s].
    """

    position: np.ndarray
    rotation: np.ndarray
    twist: np.ndarray
    drift: np.ndarray
    guarded_positions: list[list[float]]
    guarded_speeds: list[float]
    tool_speed: float


class Speeds(NamedTuple):
    """Speeds of the guarded points and of the tool, as in `Motion`."""

    guarded_speeds: list[float]
    tool_speed: float


class Dynamics(NamedTuple):
    """Dynamic quantities of one state that a torque law needs in addition to `Motion`.

    Attributes:
        jacobian: Jacobian from joint speeds to the tool's twist. Shape (6, n).
        inverse_mass: M(q)^-1, rotors included. Shape (n, n).
        bias: C(q, qd) qd + g(q) [N m]. Shape (n,).
    """

    jacobian: np.ndarray
    inverse_mass: np.ndarray
    bias: np.ndarray


class Arm:
    """A chain of one-degree-of-freedom joints, read from a URDF; other joints are locked at zero.

    The reflected rotor inertia of a joint is read from the attribute `armature` [kg m^2] of its
    `<dynamics>` element (MuJoCo's name; Pinocchio's URDF reader ignores it). Forward and inverse
    dynamics do not include friction.

    Attributes:
        joint_names: Names of the joints, in the order of all joint vectors.
        q_min: Lower position limits [rad]. Shape (n,).
        q_max: Upper position limits [rad]. Shape (n,).
        qd_max: Speed limits [rad/s]. Shape (n,).
        approach: Speeds near the position limits, n of them; empty if the URDF has none.
        tau_max: Torque limits [N m]. Shape (n,).
        armature: Reflected rotor inertia [kg m^2]. Shape (n,).
        friction: Coulomb friction of the joints [N m]. Shape (n,).
        damping: Viscous friction of the joints [N m s/rad]. Shape (n,).
        torque_scales: True torque of each joint over the commanded one; None if all are 1.
            Shape (n,).
        asymmetry: Share by which Coulomb friction is larger forwards than on average. Shape (n,).
        low_speed_friction: Share of it that is added at low speed. Shape (n,).
        model: Pinocchio's model of the chain, whose universe is the base frame.
        root: Pose of the URDF's root link, which is upright, in the base frame.

    Args:
        joint_names: Names of the joints, base to tip.
        guarded: Points whose motion is limited in addition to the tool's; by default the WAM's, of
            a URDF that has its links.
        corrections: What was measured on this arm, None for an arm as its URDF describes it.
        base_frame: Link whose frame is the base frame of all numbers; the root link if empty.
        position_limits: Limits in place of the URDF's, see `urdf_checks.limited` [rad].

    Raises:
        ValueError: The text is not a URDF, a joint or frame is missing (the message lists the known
            ones), the base frame moves, or a joint, limit, inertia, armature or guarded point is
            not valid.
    """

    def __init__(
        self,
        urdf: str,
        joint_names: Sequence[str],
        tool_frame: str = "pan",
        guarded: Sequence[GuardedPoint] | None = None,
        corrections: Corrections | None = None,
        base_frame: str = "",
        position_limits: Sequence[float] = (),
    ) -> None:
        self.joint_names = tuple(joint_names)
        urdf = limited(urdf, self.joint_names, position_limits)
        tree = parsed(urdf)
        require_usable(tree, self.joint_names)
        self._base_frame = base_frame
        try:
            full = pin.buildModelFromXML(urdf)
        except (ValueError, RuntimeError) as error:
            raise ValueError(f"the robot description is not a URDF: {error}") from None
        self.name = tree.get("name", "")
        self.model = _chain(full, self.joint_names)
        if guarded is None:
            known = (point.link for point in WAM_GUARDED_POINTS)
            there = all(self.model.existFrame(link, _LINK) for link in known)
            guarded = WAM_GUARDED_POINTS if there else ()
        self._given = urdf, self.joint_names, tool_frame, tuple(guarded)
        require_physical(tree, self.model)
        low, high = np.transpose([soft_limits(tree, name) for name in self.joint_names])
        self.model.lowerPositionLimit = np.maximum(self.model.lowerPositionLimit, low)
        self.model.upperPositionLimit = np.minimum(self.model.upperPositionLimit, high)
        self.n = self.model.nv
        if self.n > JOINTS_MAX:
            raise ValueError(f"{self.n} joints are too many, at most {JOINTS_MAX} are possible")
        self.approach = approach(tree, self.joint_names)
        self.armature = np.array([_armature(tree, name) for name in self.joint_names])
        self.model.armature = self.armature
        self.root = rebased(self.model, base_frame) if base_frame else pin.SE3.Identity()
        self.tool_frame = self._tool = _link(self.model, tool_frame)
        self._zero = np.zeros(self.n)
        self._data = self.model.createData()
        self._identity = self._identified()
        self.torque_scales: np.ndarray | None = None
        self.asymmetry = self.low_speed_friction = self._zero
        self._uncorrected: pin.Model | None = None
        if corrections is not None:
            if corrections.of_gravity:
                self._uncorrected = self.model.copy()
                self._uncorrected_data = self._uncorrected.createData()
            corrections.apply(self.model, self._tool, self.root.rotation)
            self.asymmetry = corrections.friction_asymmetry
            self.low_speed_friction = corrections.low_speed_friction
            if np.any(corrections.torque_scales != 1.0):
                self.torque_scales = corrections.torque_scales
        self.q_min = self.model.lowerPositionLimit.copy()
        self.q_max = self.model.upperPositionLimit.copy()
        self.qd_max = self.model.velocityLimit.copy()
        self.tau_max = self.model.effortLimit.copy()
        self.friction = self.model.friction.copy()
        self.damping = self.model.damping.copy()
        self._uneven = bool(self.asymmetry.any() or self.low_speed_friction.any())
        self._data = self.model.createData()
        self.guarded = tuple(point.name for point in guarded)
        self._guarded = [
            self._point(_link(self.model, link), read_only(f"guarded point {name}", offset, (3,)))
            for name, link, offset in guarded
        ]
        self._moving = [*self._guarded, self._point(self._tool, np.zeros(3))]
        placement = self._data.oMf[self._tool]
        self._tool_position, self._tool_rotation = placement.translation, placement.rotation

    def __reduce__(self) -> NoReturn:
        """Refuse to copy: the views would still show the buffers of the original."""
        raise TypeError("an Arm cannot be copied; create another one from the same URDF")

    def corrected(self, corrections: Corrections) -> Arm:
        """Another model of this arm, with these corrections in place of its own."""
        return Arm(*self._given, corrections, self._base_frame)

    def _point(self, frame: int, offset: np.ndarray) -> _Point:
        """Point at an offset (3,) [m] in a frame."""
        data, parent = self._data, self.model.frames[frame]
        joint, offset = int(parent.parentJoint), parent.placement.act(offset)
        pose, twist = data.oMi[joint], data.v[joint].vector
        return _Point(pose.translation, pose.rotation, twist, offset.tolist())

    def identity(self) -> ArmIdentity:
        """Name, joint names, and digests of the kinematics and masses of its URDF."""
        return self._identity

    def _identified(self) -> ArmIdentity:
        zero = self._zero
        axes = pin.computeJointJacobians(self.model, self._data, zero)  # in the base frame
        geometry = np.concatenate([axes.ravel(), *(part.ravel() for part in self.tool_pose(zero))])
        masses = [link.toDynamicParameters() for link in list(self.model.inertias)[1:]]
        numbers = np.concatenate([*masses, self.armature])
        return ArmIdentity(
            name=self.name[:255],
            joint_names=self.joint_names,
            kinematics=_digest([f"{number:.4f}" for number in geometry.round(4) + 0.0]),
            dynamics=_digest([f"{number:.3e}" for number in numbers.round(9) + 0.0]),
        )

    def motion(self, q: np.ndarray, qd: np.ndarray) -> Motion:
        """Kinematics of one state: positions [rad] and speeds [rad/s], shapes (n,)."""
        model, data, tool = self.model, self._data, self._tool
        pin.forwardKinematics(model, data, q, qd, self._zero)
        pin.updateFramePlacement(model, data, tool)
        twist = pin.getFrameVelocity(model, data, tool, _AXES).vector
        drift = pin.getFrameClassicalAcceleration(model, data, tool, _AXES).vector
        position, rotation = self._tool_position.copy(), self._tool_rotation.copy()
        points = self._guarded
        reached = _positions(points), _speeds(points), _length(twist)
        return Motion(position, rotation, twist, drift, *reached)

    def speeds(self, q: np.ndarray, qd: np.ndarray) -> Speeds:
        """Speeds of one state, in a third of the time that `motion` takes."""
        pin.forwardKinematics(self.model, self._data, q, qd)
        *guarded, tool = _speeds(self._moving)
        return Speeds(guarded, tool)

    def dynamics(self, q: np.ndarray, qd: np.ndarray, bias: np.ndarray | None = None) -> Dynamics:
        """Jacobian, inverse mass matrix and bias torque of one state; the bias may be given."""
        model, data = self.model, self._data
        return Dynamics(
            jacobian=pin.computeFrameJacobian(model, data, q, self._tool, _AXES),
            inverse_mass=pin.computeMinverse(model, data, q),
            bias=self.bias(q, qd) if bias is None else bias,
        )

    def tool_pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) [m] and rotation matrix (3, 3) of the tool frame in the base frame."""
        pin.forwardKinematics(self.model, self._data, q)
        placement = pin.updateFramePlacement(self.model, self._data, self._tool)
        return placement.translation.copy(), placement.rotation.copy()

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Jacobian from joint speeds to the tool's twist in the base frame. Shape (6, n)."""
        return pin.computeFrameJacobian(self.model, self._data, q, self._tool, _AXES)

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """M(q) [kg m^2], rotors included. Shape (n, n)."""
        return pin.crba(self.model, self._data, q)

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """g(q) [N m]. Shape (n,)."""
        return pin.computeGeneralizedGravity(self.model, self._data, q)

    def gravity_slope(self, q: np.ndarray) -> np.ndarray:
        """Change of g(q) with q [N m/rad]. Shape (n, n)."""
        return pin.computeGeneralizedGravityDerivatives(self.model, self._data, q)

    def driver_gravity(self, q: np.ndarray) -> np.ndarray:
        """g(q) of a driver that adds it: of the URDF, without corrections [N m]. Shape (n,)."""
        if self._uncorrected is None:
            return self.gravity(q)
        return pin.computeGeneralizedGravity(self._uncorrected, self._uncorrected_data, q).copy()

    def bias(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """C(q, qd) qd + g(q) [N m]. Shape (n,)."""
        return pin.nonLinearEffects(self.model, self._data, q, qd)

    def friction_torque(self, qd: np.ndarray) -> np.ndarray:
        """Torque that overcomes Coulomb and viscous friction at these speeds [N m]. Shape (n,)."""
        direction = np.tanh(qd / FRICTION_SPEED)
        if self._uneven:
            slow = 1.0 + self.low_speed_friction * np.exp(-((qd / STRIBECK_SPEED) ** 2))
            direction = direction * slow + np.abs(direction) * self.asymmetry
        return self.friction * direction + self.damping * qd

    def inverse_dynamics(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """Torque for an acceleration, by recursive Newton-Euler [N m]. Shape (n,)."""
        return pin.rnea(self.model, self._data, q, qd, qdd)

    def resisted_dynamics(
        self, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, resistance: np.ndarray, dt: float
    ) -> np.ndarray:
        """Acceleration [rad/s^2] against a resistance that acts on the speed it leads to. (n,).

        Solves (M + dt R) qdd = tau - C qd - g - R qd for qdd, so that the friction R (qd + dt qdd)
        brakes a joint of any inertia and never turns it back, however long the step.

        Args:
            q: Joint positions [rad]. Shape (n,).
            qd: Joint speeds [rad/s]. Shape (n,).
            tau: Joint torques [N m]. Shape (n,).
            resistance: Diagonal of R, not negative [N m s/rad]. Shape (n,).
            dt: Step of the integration [s].
        """
        model = self.model
        model.armature = self.armature + dt * resistance
        try:
            return pin.aba(model, self._data, q, qd, tau - resistance * qd)
        finally:
            model.armature = self.armature


def rebased(model: pin.Model, base_frame: str) -> pin.SE3:
    """Make a fixed link the frame of all numbers of a model; returns the root's pose in it.

    Raises:
        ValueError: There is no such link, or it moves.
    """
    base = model.frames[_link(model, base_frame)]
    if base.parentJoint:
        fixed = [it.name for it in model.frames if it.type == _LINK and not it.parentJoint]
        joint = model.names[base.parentJoint]
        raise ValueError(f"base_frame {base_frame!r} moves with joint {joint!r}; fixed are {fixed}")
    root = base.placement.inverse()
    if not root.isIdentity():  # else the URDF's numbers stay, bit for bit
        for number in range(1, model.njoints):
            if model.parents[number] == 0:
                model.jointPlacements[number] = root * model.jointPlacements[number]
        for frame in model.frames:
            if frame.parentJoint == 0:
                frame.placement = root * frame.placement
        model.gravity.linear = root.rotation @ model.gravity.linear
    return root


def _link(model: pin.Model, name: str) -> int:
    if not model.existFrame(name, _LINK):  # a joint may have the same name
        known = [frame.name for frame in model.frames if frame.type == _LINK]
        raise ValueError(f"no link {name!r} in the robot description; known: {known}")
    return int(model.getFrameId(name, _LINK))


class _Point(NamedTuple):
    """A point of a link, and the link's motion in the state that was last computed.

    Attributes:
        origin: Position of the joint that moves the link, in the base frame [m]: a view of
            Pinocchio's. Shape (3,).
        rotation: Axes of the joint as columns: a view of Pinocchio's. Shape (3, 3).
        twist: Linear and angular velocity in the frame of the joint [m/s, rad/s]: a view of
            Pinocchio's. Shape (6,).
        offset: Position in the frame of the joint [m], three numbers.
    """

    origin: np.ndarray
    rotation: np.ndarray
    twist: np.ndarray
    offset: list[float]


def _positions(points: list[_Point]) -> list[list[float]]:
    """Positions of points in the base frame [m]: three numbers each."""
    if compiled.kernel is not None:
        return compiled.kernel.point_positions(points)
    positions = []
    for point in points:
        x, y, z = point.offset
        x0, y0, z0 = point.origin.tolist()
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = point.rotation.tolist()
        position = [
            x0 + xx * x + xy * y + xz * z,
            y0 + yx * x + yy * y + yz * z,
            z0 + zx * x + zy * y + zz * z,
        ]
        positions.append(position)
    return positions


def _speeds(points: list[_Point]) -> list[float]:
    """Speeds of points [m/s]."""
    if compiled.kernel is not None:
        return compiled.kernel.point_speeds(points)
    speeds = []
    for point in points:
        vx, vy, vz, wx, wy, wz = point.twist.tolist()
        x, y, z = point.offset
        vx += wy * z - wz * y
        vy += wz * x - wx * z
        vz += wx * y - wy * x
        speeds.append(math.sqrt(vx * vx + vy * vy + vz * vz))
    return speeds


def _chain(full: pin.Model, joint_names: tuple[str, ...]) -> pin.Model:
    """Reduce the model to the named joints; the others are locked at zero."""
    known = [name for name in full.names if name != "universe"]
    chain_order = tuple(name for name in known if name in joint_names)
    if chain_order != joint_names:
        raise ValueError(f"joint names {joint_names} must be, base to tip, {chain_order}")
    locked = [full.getJointId(name) for name in known if name not in joint_names]
    for frame in full.frames:  # the reduction finds the frame of a joint by its name alone
        if frame.type == _LINK:
            frame.name = f"link {frame.name}"
    reduced = pin.buildReducedModel(full, locked, pin.neutral(full))
    for frame in reduced.frames:
        if frame.type == _LINK:
            frame.name = frame.name.removeprefix("link ")
    return reduced


def _armature(tree: ElementTree.Element, joint_name: str) -> float:
    dynamics = tree.find(f"./joint[@name='{joint_name}']/dynamics")
    text = "0" if dynamics is None else dynamics.get("armature", "0")
    if not 0.0 <= (armature := number(text)) < math.inf:
        text = f"armature {text!r} of joint {joint_name!r}"
        raise ValueError(f"{text} must be a finite number that is not negative")
    return armature


def _digest(numbers: list[str]) -> str:
    return hashlib.sha256(" ".join(numbers).encode()).hexdigest()


def _length(twist: np.ndarray) -> float:
    """Length of the linear part of a twist [m/s]."""
    vx, vy, vz, *_ = twist.tolist()
    return math.sqrt(vx * vx + vy * vy + vz * vz)
