# SPDX-License-Identifier: Apache-2.0
"""Joint references: a move, a recorded movement, a brake; and these one after the other."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
import scipy


class JointTrajectory(Protocol):
    """A recorded joint movement; `demonstration.Demonstration` is one."""

    t: np.ndarray  # (N,) [s], increasing
    q: np.ndarray  # (N, n) [rad]


State = tuple[np.ndarray, np.ndarray, np.ndarray]  # q_ref, qd_ref, qdd_ref, each (n,)


class JointReference(Protocol):
    """Reference of all joints over time."""

    duration: float  # [s]

    def at(self, t: float) -> State:
        """Position [rad], speed [rad/s] and acceleration [rad/s^2] at time t [s]."""
        ...


class MinJerk:
    """Minimum-jerk move along a straight line from one posture to another, from rest to rest.

    Args:
        q_from: Posture at the beginning [rad]. Shape (n,).
        q_to: Posture at the end [rad]. Shape (n,).
        speed: Peak speed of the joint that goes farthest [rad/s].
    """

    def __init__(self, q_from: np.ndarray, q_to: np.ndarray, speed: float) -> None:
        self._from, self._way = q_from, q_to - q_from
        self._to, self._zero = q_to.copy(), np.zeros(len(q_to))
        self.duration = max(0.1, 1.875 * float(np.abs(self._way).max()) / speed)

    def at(self, t: float) -> State:
        """See `JointReference`."""
        if t >= self.duration:
            return self._to, self._zero, self._zero
        s = max(t, 0.0) / self.duration
        x = s**3 * (10.0 + s * (-15.0 + 6.0 * s))
        v = s**2 * (30.0 + s * (-60.0 + 30.0 * s)) / self.duration
        a = s * (60.0 + s * (-180.0 + 120.0 * s)) / self.duration**2
        return self._from + x * self._way, v * self._way, a * self._way


class Brake:
    """Smooth deceleration to rest; a joint that hardly moves stays where it is.

    Args:
        q: Posture at the beginning [rad]. Shape (n,).
        qd: Speed at the beginning [rad/s]. Shape (n,).
        duration: Time until the arm rests [s].
        q_min: Lower position limits; no joint brakes beyond [rad]. Shape (n,).
        q_max: Upper position limits; no joint brakes beyond [rad]. Shape (n,).
    """

    def __init__(
        self, q: np.ndarray, qd: np.ndarray, duration: float, q_min: np.ndarray, q_max: np.ndarray
    ) -> None:
        self.duration = duration
        qd = np.where(np.abs(qd) < 0.05, 0.0, qd)
        way = 0.5 * duration * qd  # of the blend below
        way = np.clip(way, np.minimum(q_min - q, 0.0), np.maximum(q_max - q, 0.0))
        self._q, self._qd = q, way / (0.5 * duration)
        self._end, self._zero = q + way, np.zeros(len(q))

    def at(self, t: float) -> State:
        """See `JointReference`."""
        if t >= self.duration:
            return self._end, self._zero, self._zero
        s = max(t, 0.0) / self.duration
        left = 1.0 - s**3 * (10.0 + s * (-15.0 + 6.0 * s))  # share of the speed
        way = self.duration * (s - s**4 * (2.5 + s * (-3.0 + s)))  # its integral
        change = -(s**2) * (30.0 + s * (-60.0 + 30.0 * s)) / self.duration
        return self._q + way * self._qd, left * self._qd, change * self._qd


@dataclass(eq=False)
class Sampled:
    """Recorded movement, sampled on the control grid.

    Attributes:
        q: Joint positions [rad]. Shape (rows, n).
        qd: Joint speeds [rad/s]. Shape (rows, n).
        qdd: Joint accelerations [rad/s^2]. Shape (rows, n).
        duration: Duration of the movement [s].
        period: Sampling period of the control loop [s].
    """

    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    duration: float
    period: float

    def at(self, t: float) -> State:
        """See `JointReference`; the nearest row."""
        row = min(max(round(t / self.period), 0), len(self.q) - 1)
        return self.q[row], self.qd[row], self.qdd[row]


def interpolated(t: npt.ArrayLike, q: npt.ArrayLike, speed: float, period: float) -> Sampled:
    """Interpolate a recorded movement by a cubic spline and sample it on the control grid.

    Args:
        t: Times, strictly increasing [s]. Shape (N,), N >= 4.
        q: Joint positions, smooth [rad]. Shape (N, n).
        speed: 1 for as recorded.
        period: Sampling period of the control loop [s].

    Raises:
        ValueError: A shape or value is not allowed; names it.
    """
    times, joints = np.array(t, dtype=float), np.array(q, dtype=float)
    if times.ndim != 1 or joints.ndim != 2 or not len(joints) == len(times) >= 4:
        raise ValueError(f"t {times.shape} and q {joints.shape} must be (N,) and (N, n), N >= 4")
    if not (
        np.isfinite(times).all() and np.isfinite(joints).all() and np.all(np.diff(times) > 0.0)
    ):
        raise ValueError("the times must increase and all values be finite")
    if not 0.0 < speed < math.inf:
        raise ValueError(f"speed {speed} must be positive")
    duration = float(times[-1] - times[0]) / speed
    if duration > 600.0:
        raise ValueError(f"the movement takes {duration:.0f} s; at most 600 allowed")
    spline = scipy.interpolate.CubicSpline((times - times[0]) / speed, joints)
    grid = np.minimum(np.arange(round(duration / period) + 1) * period, duration)
    rows, speeds, accelerations = (spline(grid, order) for order in range(3))
    return Sampled(rows, speeds, accelerations, duration, period)


class Course:
    """Sequence of references, each from where the last one ends, and a brake after all.

    Attributes:
        reference: Reference that is being followed; None until the first state after `begin`.

    Args:
        brake: Makes a brake from a posture [rad] and a speed [rad/s].
    """

    def __init__(self, brake: Callable[[np.ndarray, np.ndarray], Brake]) -> None:
        self._brake = brake
        self._plan: deque[JointReference | Callable[[np.ndarray], JointReference]] = deque()
        self._since_ns = 0
        self.reference: JointReference | None = None

    def begin(self, *steps: JointReference | Callable[[np.ndarray], JointReference]) -> None:
        """Drop what is under way, and follow these from the next state on; without any, brake.

        Args:
            *steps: References, or functions that make one from the posture where it begins [rad].
        """
        self._plan = deque(steps)
        self.reference = None

    @property
    def ended(self) -> bool:
        """Whether only the brake is left."""
        return isinstance(self.reference, Brake)

    def at(self, stamp_ns: int, q: np.ndarray, qd: np.ndarray) -> State:
        """Reference for the state with this stamp; it begins, if it has not yet, at `q`, `qd`."""
        reference = self.reference or self._next(stamp_ns, q, qd)
        while not isinstance(reference, Brake):
            end_ns = self._since_ns + round(reference.duration * 1e9)
            if stamp_ns < end_ns:
                break
            q_end, qd_end, _ = reference.at(reference.duration)
            reference = self._next(end_ns, q_end, qd_end)
        return reference.at((stamp_ns - self._since_ns) * 1e-9)

    def _next(self, stamp_ns: int, q: np.ndarray, qd: np.ndarray) -> JointReference:
        self._since_ns = stamp_ns
        step = self._plan.popleft() if self._plan else self._brake(q, qd)
        self.reference = step(q) if callable(step) else step
        return self.reference
