# SPDX-License-Identifier: Apache-2.0
"""Limits on torque and motion, and the fallback torque when something fails.

None of this is a safety function: the pendant and the robot's own safety board are. All functions
are pure and give the same bits for the same arguments.

The fallback, g(q) - d M(q) qd, brings the arm to rest and carries it. While joint
states are missing it uses the state that the model predicts: an old velocity would feed energy in.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from wam_power_ros import compiled
from wam_power_ros.control.arm import Arm, Motion, Speeds
from wam_power_ros.control.modes import MOVING_MODES, PASSIVE_MODES, WORKSPACE_MODES, Mode
from wam_power_ros.control.state_checks import JointState, at_rate
from wam_power_ros.control.urdf_checks import Approach
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.policy import PERIOD, read_only

# Shapes that are not (n,)
_SHAPES: dict[str, tuple[int, ...]]
_SHAPES = dict.fromkeys(("guarded_speed", "tool_speed", "teaching_tool_speed"), ())
_SHAPES |= {"workspace_min": (3,), "workspace_max": (3,), "plane": (4,)}
_SIGNED = ("q_min", "q_max", "workspace_min", "workspace_max", "plane")  # may be negative
SPRING_RANGE = 0.1  # [rad] width of the soft springs inside the position limits
SPRING_RISE = 0.05  # [s] in which their torque may rise to that at a limit: a joint at 2 rad/s
START_TIME = 0.25  # [s] after standstill in which less than the teaching speed is allowed, because
START_MARGIN = 0.25  # [m/s] so fast starts an arm that has lost its tool; at most half of the limit
START_SPEED = 0.01  # [m/s] of the tool, below which it stands still
FAULT_STATES = 3  # consecutive states beyond a motion limit that are a fault, at 500 Hz
OUTWARDS = 0.05  # [rad/s] from which a joint beyond a position limit moves further outwards
REST_SPEED = 0.05  # [m/s] largest speed of an arm at rest
REST_SPIN = 4.0 * REST_SPEED  # [rad/s] largest angular velocity of its tool
RELIEF_SPEED = 0.02  # [rad/s] from which a joint counts as moved by a person
FAULT_DAMPING = 20.0  # [1/s] decay rate of all joint motion in a fault
# Decay rate of all joint motion while teaching, at TEACHING_SPEED. It grows with the square of the
# speed, so that a person does not feel it at low speed and needs about 10 N at 2.5 m/s.
TEACHING_DAMPING = 1.0  # [1/s]
TEACHING_SPEED = 2.5  # [m/s] of the tool


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits that no command and no motion may exceed. Arrays are copied and read-only.

    Attributes:
        torque: Largest torque [N m]. Shape (n,).
        torque_rate: Largest torque rate [N m/s]; 2000 by default. A rate limit that is reached in a
            movement delays the torques, and the arm oscillates with growing amplitude: at 500 in a
            hold that a person pushes with 40 N, until a fault; at 1000 (libfranka's limit, for
            smaller motors) joint 2 in a fast toss. Shape (n,).
        q_min: Lower position limits [rad]. Shape (n,).
        q_max: Upper position limits [rad]. Shape (n,).
        qd_max: Largest joint speed [rad/s]. Shape (n,).
        approach: Speeds near the position limits, n of them; empty for none.
        spring_torque: Torque of the soft spring at a position limit [N m]. Shape (n,).
        guarded_speed: Largest speed of the arm's guarded points [m/s]. The WAM's safety board trips
            at 1.0 m/s as delivered; a toss needs up to 2.0, and the board set accordingly.
        tool_speed: Largest tool speed in all modes but teaching [m/s]; a toss needs about 2.5.
        teaching_tool_speed: Largest tool speed while a person guides the arm [m/s]; less within
            `START_TIME` after it stood still. A task that is taught fast raises it by name.
        workspace_min: Lower corner of the box that the tool must stay in during rollout and replay
            [m]. Shape (3,).
        workspace_max: Upper corner [m]. Shape (3,).
        plane: Normal n and distance d [m] of a keep-out plane (a table, a wall): tool and guarded
            points must keep n . x >= d while the arm moves by itself. Shape (4,).

    Raises:
        ValueError: A value is out of range; the message names it and the rule.
    """

    torque: np.ndarray
    torque_rate: np.ndarray
    q_min: np.ndarray
    q_max: np.ndarray
    qd_max: np.ndarray
    spring_torque: np.ndarray
    guarded_speed: float = 2.0
    tool_speed: float = 4.0
    teaching_tool_speed: float = 0.5
    workspace_min: np.ndarray = field(default_factory=lambda: np.array([-1.5, -1.5, -0.5]))
    workspace_max: np.ndarray = field(default_factory=lambda: np.array([1.5, 1.5, 2.0]))
    plane: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0, -0.5]))
    approach: tuple[Approach, ...] = ()
    # The same values as plain floats, one row per joint or axis: several times faster to compare.
    _torques: list[list[float]] = field(init=False, repr=False)
    _motions: list[list[float]] = field(init=False, repr=False)
    _spring_free: list[list[float]] = field(init=False, repr=False)
    _box: list[list[float]] = field(init=False, repr=False)
    _plane: list[float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        n = np.size(self.torque)
        for name in _names():
            value = getattr(self, name)
            shape = _SHAPES.get(name, (n,))
            array = read_only(f"limit {name}", value, shape)
            if name not in _SIGNED and not np.all(array > 0.0):
                raise ValueError(f"limit {name} = {value} must be positive")
            if shape:
                object.__setattr__(self, name, array)
        for lower, upper in (("q_min", "q_max"), ("workspace_min", "workspace_max")):
            if not np.all(getattr(self, lower) < getattr(self, upper)):
                raise ValueError(f"limit {lower} = {getattr(self, lower)} must be below {upper}")
        if abs(float(np.linalg.norm(self.plane[:3])) - 1.0) > 1e-6:
            raise ValueError(f"limit plane = {self.plane} must begin with a unit normal")
        possible = all(offset >= 0.0 < deceleration for offset, deceleration in self.approach)
        if len(self.approach) not in (0, n) or not possible:
            raise ValueError(f"limit approach = {self.approach} must be none, or {n} that brake")
        low, high = self.q_min, self.q_max
        for name, columns in (
            ("_torques", (self.torque, self.torque_rate)),
            ("_motions", (low, high, self.qd_max)),
            ("_spring_free", (low + SPRING_RANGE, high - SPRING_RANGE)),
            ("_box", (self.workspace_min, self.workspace_max)),
        ):
            object.__setattr__(self, name, np.stack(columns, axis=1).tolist())
        object.__setattr__(self, "_plane", self.plane.tolist())


def _names() -> list[str]:
    return [each.name for each in fields(Limits) if each.init and each.name != "approach"]


def limits_of(arm: Arm, **overrides: object) -> Limits:
    """Limits of an arm: from its URDF, with defaults for the rest.

    Raises:
        ValueError: A field does not exist, or a value is out of range.
    """
    known = [*_names(), "approach"]
    if unknown := sorted(set(overrides) - set(known)):
        raise ValueError(f"limits {unknown} do not exist; known: {sorted(known)}")
    values: dict[str, Any] = {
        "torque": arm.tau_max,
        "torque_rate": np.full(arm.n, 2000.0),
        "q_min": arm.q_min,
        "q_max": arm.q_max,
        "qd_max": arm.qd_max,
        "approach": arm.approach,
        "spring_torque": 0.1 * arm.tau_max,
    }
    return Limits(**(values | overrides))


def limit_torque(tau: np.ndarray, previous: np.ndarray, dt: float, limits: Limits) -> np.ndarray:
    """Clip a torque (n,) [N m] to the limits of magnitude, and of rate since the `previous` one.

    When `tau` is within both limits, the result is `tau` itself. `dt` is the time since that [s].
    """
    if _keeps(tau, previous, dt, limits):
        return tau
    step = limits.torque_rate * dt
    low = np.maximum(previous - step, -limits.torque)
    high = np.minimum(previous + step, limits.torque)
    return np.minimum(np.maximum(tau, low), high)


def _keeps(tau: np.ndarray, previous: np.ndarray, dt: float, limits: Limits) -> bool:
    """Whether a torque is within the limits of magnitude and rate; see `limit_torque`."""
    if compiled.kernel is not None:
        return compiled.kernel.torque_within(tau, previous, limits._torques, dt)
    rows = zip(tau.tolist(), previous.tolist(), limits._torques, strict=True)
    for requested, last, (peak, rate) in rows:
        change = rate * dt
        if not (last - change <= requested <= last + change and -peak <= requested <= peak):
            return False
    return True


def _within(values: np.ndarray, bounds: list[list[float]]) -> bool:
    """Whether each of these values lies between its two bounds."""
    if compiled.kernel is not None:
        return compiled.kernel.within(values, bounds)
    rows = zip(values.tolist(), bounds, strict=True)
    return all(low <= value <= high for value, (low, high) in rows)


def limit_springs(q: np.ndarray, limits: Limits) -> np.ndarray | None:
    """Torque (n,) [N m] of the soft springs that keep joints off their limits, None if none acts.

    It rises linearly from zero at `SPRING_RANGE` inside a limit to `spring_torque` at the limit and
    to twice that at `SPRING_RANGE` beyond it, where it saturates.
    """
    if _within(q, limits._spring_free):
        return None
    below = limits.q_min + SPRING_RANGE - q
    above = q - limits.q_max + SPRING_RANGE
    depth = np.maximum(below, 0.0) - np.maximum(above, 0.0)
    share = np.minimum(np.maximum(depth / SPRING_RANGE, -2.0), 2.0)
    return share * limits.spring_torque


class LimitSprings:
    """The soft springs over time: their torque never steps, however a joint passed its limit."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._last: np.ndarray | None = None  # torque of the springs, None when none acts [N m]

    def torque(self, q: np.ndarray, dt: float) -> np.ndarray | None:
        """Torque of the springs (n,) [N m] at a posture (n,) [rad], a time [s] after the last call.

        None when none acts.
        """
        wanted, last, zero = limit_springs(q, self._limits), self._last, np.zeros(len(q))
        if wanted is None and last is None:
            return None
        last, wanted = zero if last is None else last, zero if wanted is None else wanted
        step = self._limits.spring_torque * (dt / SPRING_RISE)
        torque = np.minimum(np.maximum(wanted, last - step), last + step)
        if np.isnan(torque).any():  # the posture is none; the caller sends no such torque
            return torque
        self._last = torque if torque.any() else None
        return self._last


def friction_relief(
    friction: np.ndarray, asymmetry: np.ndarray, damping: np.ndarray, qd: np.ndarray
) -> np.ndarray:
    """Friction of joints that move, signed [N m], shape (n,); zero of those that stand still.

    Joints that stand still get none, so that it never sets an arm in motion. Coulomb friction
    counts as in the direction in which it is smaller.

    Args:
        friction: Coulomb friction [N m]. Shape (n,).
        asymmetry: Share by which it is larger forwards than on average. Shape (n,).
        damping: Viscous friction [N m s/rad]. Shape (n,).
        qd: Speeds [rad/s]. Shape (n,).
    """
    moving = np.maximum(np.abs(qd) - RELIEF_SPEED, 0.0)
    least = friction * (1.0 - np.abs(asymmetry)) + damping * np.abs(qd)
    return least * np.copysign(np.tanh(moving / RELIEF_SPEED), qd)


def teaching_damping(speed: float) -> float:
    """Damping while teaching [1/s]; it grows with the square of the tool speed [m/s]."""
    return TEACHING_DAMPING * (speed / TEACHING_SPEED) ** 2


def rest_violation(motion: Motion) -> str:
    """Reason why the arm is not at rest; empty when it is."""
    speed = max(*motion.guarded_speeds, motion.tool_speed, 0.0)
    if speed > REST_SPEED:
        return f"the arm moves at {speed:.3f} m/s, limit {REST_SPEED}"
    spin = float(np.abs(motion.twist[3:]).max())
    if spin > REST_SPIN:
        return f"the tool turns at {spin:.3f} rad/s, limit {REST_SPIN}"
    return ""


def motion_fault(
    q: list[float],
    qd: list[float],
    motion: Motion | Speeds,
    guarded: Sequence[str],
    limits: Limits,
    tool_speed: float,
    workspace: bool,
) -> Fault | None:
    """Fault of the first motion limit that a state exceeds, or None.

    Beyond a position limit only motion further outwards is a fault, so that an arm parked at its
    stop can be moved away from it.

    Args:
        q: Joint positions [rad], n numbers.
        qd: Joint speeds [rad/s], n numbers.
        tool_speed: Limit of the tool speed in this mode [m/s].
    """
    kernel, bounds = compiled.kernel, limits._motions
    kept = kernel is not None and kernel.joints_within(q, qd, bounds, OUTWARDS)
    rows = () if kept else zip(q, qd, bounds, strict=True)
    for i, (x, speed, (low, high, speed_max)) in enumerate(rows, start=1):
        if not -speed_max <= speed <= speed_max:
            text = f"joint {i} at {speed:.2f} rad/s, limit {speed_max:.2f}"
            return Fault(FaultKind.JOINT_SPEED, text)
        if (x > high and speed > OUTWARDS) or (x < low and speed < -OUTWARDS):
            text = f"joint {i} at {x:.3f} rad, limits {low:.3f} to {high:.3f}"
            return Fault(FaultKind.JOINT_POSITION, text)
    if limits.approach and (fault := _approach_fault(q, qd, limits)) is not None:
        return fault
    if motion.tool_speed > tool_speed:
        text = f"tool at {motion.tool_speed:.2f} m/s, limit {tool_speed:.2f}"
        return Fault(FaultKind.TOOL_SPEED, text)
    for name, speed in zip(guarded, motion.guarded_speeds, strict=True):
        if speed > limits.guarded_speed:
            text = f"{name} at {speed:.2f} m/s, limit {limits.guarded_speed:.2f}"
            return Fault(FaultKind.GUARDED_SPEED, text)
    if workspace and isinstance(motion, Motion):
        for axis, x, (low, high) in zip("xyz", motion.position.tolist(), limits._box, strict=True):
            if not low <= x <= high:
                text = f"tool at {axis} = {x:.3f} m, workspace {low:.3f} to {high:.3f}"
                return Fault(FaultKind.WORKSPACE, text)
    return None


def _approach_fault(q: list[float], qd: list[float], limits: Limits) -> Fault | None:
    """Fault of the first joint that is too fast for its distance from the limit ahead, or None."""
    rows = zip(q, qd, limits._motions, limits.approach, strict=True)
    for i, (x, speed, (low, high, _), (offset, deceleration)) in enumerate(rows, start=1):
        room = max(high - x if speed > 0.0 else x - low, 0.0)
        allowed = max(math.sqrt(2.0 * deceleration * room) - offset, 0.0) + OUTWARDS
        if abs(speed) > allowed:
            text = f"joint {i} at {speed:.2f} rad/s, limit {allowed:.2f} at {x:.2f} rad"
            return Fault(FaultKind.JOINT_SPEED, text)
    return None


def plane_fault(points: Mapping[str, Sequence[float]], limits: Limits) -> Fault | None:
    """Fault of the first point, by name [m], behind the keep-out plane, or None."""
    nx, ny, nz, distance = limits._plane
    for name, (x, y, z) in points.items():
        if not nx * x + ny * y + nz * z >= distance:
            depth = distance - nx * x - ny * y - nz * z
            text = f"{name} is {depth:.3f} m behind the plane {limits._plane}"
            return Fault(FaultKind.PLANE, text)
    return None


class MotionCheck:
    """Compares every state with the motion limits of its mode."""

    def __init__(self, limits: Limits, guarded: Sequence[str], period: float = PERIOD) -> None:
        self._limits, self._guarded = limits, guarded
        self._to_fault = at_rate(FAULT_STATES, period)
        self.begin()

    def begin(self) -> None:
        """Restart the counts, for another mode."""
        self._in_row = 0  # consecutive states beyond a limit
        self._moved = 0.0  # time since the arm stood still [s]

    def fault(self, mode: Mode, state: JointState, motion: Motion | Speeds) -> Fault | None:
        """Fault of a limit that `FAULT_STATES` consecutive states exceed, or None.

        Args:
            mode: Current mode; it decides which limits apply.
            motion: Kinematics of the state; the speeds suffice unless the arm moves by itself.
        """
        if mode in PASSIVE_MODES:
            return None
        limits, guarded = self._limits, self._guarded
        teaching = mode is Mode.GRAVITY_COMPENSATION
        tool_speed = limits.teaching_tool_speed if teaching else limits.tool_speed
        self._moved = self._moved + state.dt if motion.tool_speed > START_SPEED else 0.0
        if teaching and self._moved < START_TIME:
            tool_speed -= min(START_MARGIN, 0.5 * tool_speed)
        workspace = mode in WORKSPACE_MODES
        joints = state.positions, state.speeds
        fault = motion_fault(*joints, motion, guarded, limits, tool_speed, workspace)
        if fault is None and mode in MOVING_MODES and isinstance(motion, Motion):
            points = dict(zip(guarded, motion.guarded_positions, strict=True))
            points["tool"] = motion.position.tolist()
            fault = plane_fault(points, limits)
        self._in_row = 0 if fault is None else self._in_row + 1
        return fault if self._in_row >= self._to_fault else None
