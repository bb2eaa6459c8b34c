# SPDX-License-Identifier: Apache-2.0
"""Joint references: a move, a recorded movement, braking to rest; and sequences of these."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
import scipy

State = tuple[np.ndarray, np.ndarray, np.ndarray]  # q_ref, qd_ref, qdd_ref, each (n,)


class JointReference(Protocol):
    """Reference of all joints over time."""

    duration: float  # [s]

    def at(self, t: float) -> State:
        """Position [rad], speed [rad/s] and acceleration [rad/s^2] at time t [s]."""
        ...


# A reference, or a function that makes one from the posture (n,) [rad] where it begins.
Step = JointReference | Callable[[np.ndarray], JointReference]


class MinJerk:
    """Minimum-jerk move from a posture to another (n,) [rad], straight and from rest to rest.

    The joint with the largest displacement has the peak `speed` [rad/s].
    """

    def __init__(self, q_from: np.ndarray, q_to: np.ndarray, speed: float) -> None:
        self._from, self._displacement = q_from, q_to - q_from
        self._to, self._zero = q_to.copy(), np.zeros(len(q_to))
        self.duration = max(0.1, 1.875 * float(np.abs(self._displacement).max()) / speed)

    def at(self, t: float) -> State:
        """See `JointReference`."""
        if t >= self.duration:
            return self._to, self._zero, self._zero
        s = max(t, 0.0) / self.duration
        x = s**3 * (10.0 + s * (-15.0 + 6.0 * s))
        v = s**2 * (30.0 + s * (-60.0 + 30.0 * s)) / self.duration
        a = s * (60.0 + s * (-180.0 + 120.0 * s)) / self.duration**2
        way = self._displacement
        return self._from + x * way, v * way, a * way


class Brake:
    """Smooth deceleration to rest; a joint slower than 0.05 rad/s keeps its position.

    It begins at posture q [rad] and speed qd [rad/s], takes `duration` [s], and no joint comes to
    rest beyond its limits [rad]. Shapes (n,).
    """

    def __init__(
        self, q: np.ndarray, qd: np.ndarray, duration: float, q_min: np.ndarray, q_max: np.ndarray
    ) -> None:
        self.duration = duration
        qd = np.where(np.abs(qd) < 0.05, 0.0, qd)
        distance = 0.5 * duration * qd  # of the speed profile in `at`
        distance = np.clip(distance, np.minimum(q_min - q, 0.0), np.maximum(q_max - q, 0.0))
        self._q, self._qd = q, distance / (0.5 * duration)
        self._end, self._zero = q + distance, np.zeros(len(q))

    def at(self, t: float) -> State:
        """See `JointReference`."""
        if t >= self.duration:
            return self._end, self._zero, self._zero
        s = max(t, 0.0) / self.duration
        speed = 1.0 - s**3 * (10.0 + s * (-15.0 + 6.0 * s))  # relative to the initial speed
        distance = self.duration * (s - s**4 * (2.5 + s * (-3.0 + s)))  # its integral
        acceleration = -(s**2) * (30.0 + s * (-60.0 + 30.0 * s)) / self.duration
        return self._q + distance * self._qd, speed * self._qd, acceleration * self._qd


@dataclass(eq=False)
class Sampled:
    """Recorded movement, sampled at the control period.

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


def interpolated(t: npt.ArrayLike, q: npt.ArrayLike, period: float) -> Sampled:
    """Interpolate a movement (N, n) [rad] by a cubic spline, and sample it every period [s].

    The times t (N,) [s] increase; N >= 4.

    Raises:
        ValueError: A shape or value is not allowed; the message names it.
    """
    times, joints = np.array(t, dtype=float), np.array(q, dtype=float)
    if times.ndim != 1 or joints.ndim != 2 or not len(joints) == len(times) >= 4:
        raise ValueError(f"t {times.shape} and q {joints.shape} must be (N,) and (N, n), N >= 4")
    if not (
        np.isfinite(times).all() and np.isfinite(joints).all() and np.all(np.diff(times) > 0.0)
    ):
        raise ValueError("the times must increase and all values be finite")
    duration = float(times[-1] - times[0])
    if duration > 600.0:
        raise ValueError(f"the movement takes {duration:.0f} s; at most 600 allowed")
    spline = scipy.interpolate.CubicSpline(times - times[0], joints)
    grid = np.minimum(np.arange(round(duration / period) + 1) * period, duration)
    rows, speeds, accelerations = (spline(grid, order) for order in range(3))
    return Sampled(rows, speeds, accelerations, duration, period)


class ReferenceSequence:
    """References followed one after the other, each from the end of the last, then a brake.

    Attributes:
        reference: Reference that is being followed; None until the first state after `begin`.

    Args:
        brake: Makes a brake from a posture [rad] and a speed [rad/s].
    """

    def __init__(self, brake: Callable[[np.ndarray, np.ndarray], Brake]) -> None:
        self._brake = brake
        self._steps: deque[Step] = deque()
        self._begin_ns = 0  # stamp at which the reference begins
        self.reference: JointReference | None = None

    def begin(self, *steps: Step) -> None:
        """Replace the sequence from the next state on; without any step, brake."""
        self._steps = deque(steps)
        self.reference = None

    @property
    def ended(self) -> bool:
        """Whether only the brake is left."""
        return isinstance(self.reference, Brake)

    def at(self, stamp_ns: int, q: np.ndarray, qd: np.ndarray) -> State:
        """Reference at a stamp; the first call after `begin` starts it at `q`, `qd`."""
        reference = self.reference or self._next(stamp_ns, q, qd)
        while not isinstance(reference, Brake):
            end_ns = self._begin_ns + round(reference.duration * 1e9)
            if stamp_ns < end_ns:
                break
            q_end, qd_end, _ = reference.at(reference.duration)
            reference = self._next(end_ns, q_end, qd_end)
        return reference.at((stamp_ns - self._begin_ns) * 1e-9)

    def _next(self, stamp_ns: int, q: np.ndarray, qd: np.ndarray) -> JointReference:
        self._begin_ns = stamp_ns
        step = self._steps.popleft() if self._steps else self._brake(q, qd)
        self.reference = step(q) if callable(step) else step
        return self.reference
