# SPDX-License-Identifier: Apache-2.0
"""Checks of joint states before any computation: stamps, values and continuity."""

from __future__ import annotations

import math
from collections import Counter, deque
from typing import NamedTuple

import numpy as np

from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.policy import PERIOD

STATE_LOSS_TIMEOUT = 0.02  # [s] without a joint state until the loss of states is a fault
IMPLAUSIBLE_Q = 20.0  # [rad] positions from here on are refused: no joint turns that far
IMPLAUSIBLE_QD = 500.0  # [rad/s] speeds from here on are refused
# A larger change in one period is a jump: of the way at the speed limit, [rad], at most [rad].
JUMP_FACTOR, JUMP_MIN, Q_JUMP = 2.0, 0.01, 0.1
_REFUSALS_TO_FAULT, _REFUSAL_WINDOW = 5, 50  # refused states within 0.1 s, at 500 Hz: a fault
_RESTART_WINDOW = 500  # states, at 500 Hz, within which a driver restarts once: 1 s
_INTEGERS = (int, np.integer)


def at_rate(states: int, period: float) -> int:
    """Number of states of this period [s] that take as long as `states` at 500 Hz.

    A slower driver does not get fewer: noise would average less.
    """
    return max(states, round(states * PERIOD / period))


class JointState:
    """An accepted joint state.

    Attributes:
        stamp_ns: Stamp of the driver's header [ns].
        q: Joint positions [rad]. Shape (n,).
        qd: Joint speeds [rad/s]. Shape (n,).
        dt: Time since the previous state, by the caller's clock if it gives one, else by the
            stamps; at most twice the period [s].
        span: Time of the arm's motion since the previous state: the longer of both, because stamps
            may be too slow and delayed states arrive in a burst; at most twice the period [s].
        positions: `q` as plain floats, with which the checks compute: for seven numbers they are
            several times faster than arrays.
        speeds: `qd` as plain floats.
        derived: Whether the speeds are differentiated, so that they step after a gap.
        bias: C(q, qd) qd + g(q) [N m], shape (n,), as the first who needed it has computed it; None
            before.
    """

    __slots__ = ("bias", "derived", "dt", "positions", "q", "qd", "span", "speeds", "stamp_ns")

    def __init__(
        self,
        stamp_ns: int,
        q: np.ndarray,
        qd: np.ndarray,
        dt: float,
        span: float,
        derived: bool = False,
    ) -> None:
        self.stamp_ns, self.q, self.qd, self.dt, self.span = stamp_ns, q, qd, dt, span
        self.derived = derived
        self.positions: list[float] = q.tolist()
        self.speeds: list[float] = qd.tolist()
        self.bias: np.ndarray | None = None

    def moved(self, q: np.ndarray, qd: np.ndarray) -> JointState:
        """Return the state with other positions [rad] and speeds [rad/s], shapes (n,)."""
        return JointState(self.stamp_ns, q, qd, self.dt, self.span)


class PastState(NamedTuple):
    """A reported posture [rad], the motor torque sent for it, and the one known beyond the model.

    Attributes:
        q: Joint positions [rad]. Shape (n,).
        tau: Motor torque commanded for `dt` after it [N m]. Shape (n,).
        external: Torque that acted beyond the model [N m]. n numbers.
        dt: Time until the next state [s].
    """

    q: np.ndarray
    tau: np.ndarray
    external: list[float]
    dt: float


def plausible(values: list[float], bound: float) -> bool:
    """Whether every position [rad] or speed [rad/s] is finite and below a bound in magnitude."""
    if math.hypot(*values) < bound:  # then each value is, too; False for a NaN
        return True
    # The sum, because every comparison with a NaN is false.
    return math.isfinite(sum(values)) and -bound < min(values) and max(values) < bound


class StateChecks:
    """Accepts or refuses joint states, and estimates velocities that a driver does not send.

    Attributes:
        counters: Number of states `accepted`, `repeated`, `older`, `rejected`; of `gaps`, `jumps`.
        last: Last accepted state, None before the first.
        before: State accepted before `last`; None without one, or after a gap.
        fault: Fault that the last state caused, None without one.
        refusal: Why the last refused state was refused, with the value and what is allowed; empty
            before the first, and for one that was unreadable.

    Args:
        period: Sampling period of the states [s].
        velocity_cutoff: Cut-off of the low-pass for differentiated positions [rad/s].
        qd_max: Speed limits of the joints [rad/s]. Shape (n,).
    """

    def __init__(self, n: int, period: float, velocity_cutoff: float, qd_max: np.ndarray) -> None:
        self.counters: Counter[str] = Counter()
        self.last: JointState | None = None
        self.before: JointState | None = None
        self.fault: Fault | None = None
        self.refused_in_row, self.refusal = 0, ""
        self._n, self._period, self._cutoff = n, period, velocity_cutoff
        self._jumps = np.minimum(Q_JUMP, JUMP_FACTOR * qd_max * period + JUMP_MIN)
        self._least_jump = float(self._jumps.min())
        self._gap_ns = 3 * round(period * 1e9)  # positions are not differentiated across a gap
        self._window = at_rate(_REFUSAL_WINDOW, period)
        self._count = 0  # states so far
        self._refusals: deque[int] = deque(maxlen=_REFUSALS_TO_FAULT)  # values of _count
        self._restart_window = at_rate(_RESTART_WINDOW, period)
        self._stamp_ns = 0  # of the last state, also if it was refused
        # Values of _count at the last two states whose stamp was older than the one before.
        self._backs = deque([-self._restart_window] * 2, maxlen=2)

    def take(
        self, stamp_ns: object, q: object, qd: object, restart: bool, elapsed: float | None = None
    ) -> JointState | None:
        """Check one joint state; returns it when it is accepted, None when repeated or refused.

        Args:
            stamp_ns: Stamp of the driver's header [ns].
            q: Joint positions [rad]. Shape (n,).
            qd: Joint speeds, None when the driver does not send them [rad/s]. Shape (n,).
            restart: Whether an older stamp means that the driver has restarted. Stamps that go back
                twice within a second do not: two publishers send states in turn.
            elapsed: Time since the last accepted state by the caller's clock, None to use the
                stamps [s].
        """
        self._count += 1
        self.fault = None
        if not isinstance(stamp_ns, _INTEGERS):
            self._refuse("rejected", f"stamp {stamp_ns} is no number of nanoseconds")
            return None
        stamp_ns, last = int(stamp_ns), self.last
        if stamp_ns < self._stamp_ns:
            self._backs.append(self._count)
        self._stamp_ns = stamp_ns
        if last is not None and stamp_ns == last.stamp_ns:
            self.counters["repeated"] += 1
            return None
        if last is not None and stamp_ns < last.stamp_ns:
            if not restart or self._count - self._backs[0] < self._restart_window:
                age = (last.stamp_ns - stamp_ns) * 1e-6
                self._refuse("older", f"stamp is {age:.1f} ms older than the last one")
                return None
            last = None
        try:
            positions = self._read("position", q, IMPLAUSIBLE_Q)
            given = self._velocity(last, stamp_ns, positions) if qd is None else qd
            speeds = self._read("velocity", given, IMPLAUSIBLE_QD)
        except (TypeError, ValueError) as error:
            self._refuse("rejected", str(error))
            return None
        self.counters["accepted"] += 1
        self.refused_in_row = 0
        gap = last is None or stamp_ns - last.stamp_ns > self._gap_ns
        advanced = self._period if last is None else (stamp_ns - last.stamp_ns) * 1e-9
        dt, longest = advanced if elapsed is None else elapsed, 2.0 * self._period
        span = min(max(advanced, dt), longest)
        state = JointState(stamp_ns, positions, speeds, min(dt, longest), span, qd is None)
        if last is not None:
            self._check_continuity(last, state, advanced, gap)
        self.before, self.last = None if gap else last, state
        return state

    def refuse(self) -> None:
        """Count an unreadable joint state as refused."""
        self._count += 1
        self.fault = None
        self._refuse("rejected", "")

    def _refuse(self, counter: str, reason: str) -> None:
        self.counters[counter] += 1
        self.refusal = reason
        self.refused_in_row += 1
        refusals = self._refusals
        refusals.append(self._count)
        if len(refusals) == _REFUSALS_TO_FAULT and self._count - refusals[0] < self._window:
            text = f"five joint states refused within {self._window}{reason and f'; {reason}'}"
            self.fault = Fault(FaultKind.STATES_REFUSED, text)

    def _read(self, quantity: str, values: object, bound: float) -> np.ndarray:
        """Copy a joint vector; ValueError when its shape is wrong or a value is not plausible."""
        array = np.array(values, dtype=float)
        if array.shape != (self._n,):
            raise ValueError(f"{quantity} has shape {array.shape}, the arm {self._n} joints")
        if not plausible(array.tolist(), bound):
            joint = int(np.argmax(np.abs(array)))  # of a NaN, if there is one
            text = f"{quantity} of joint {joint + 1} is {array[joint]:.3g}, allowed is {bound:g}"
            raise ValueError(f"{text} {'rad: degrees?' if bound == IMPLAUSIBLE_Q else 'rad/s'}")
        return array

    def _velocity(self, last: JointState | None, stamp_ns: int, q: np.ndarray) -> np.ndarray:
        """Differentiate and low-pass the positions [rad/s]; across a gap, keep the last speeds."""
        if last is None:
            return np.zeros(self._n)
        if stamp_ns - last.stamp_ns > self._gap_ns:
            return last.qd
        dt = (stamp_ns - last.stamp_ns) * 1e-9
        share = 1.0 - math.exp(-self._cutoff * dt)
        qd = last.qd + share * ((q - last.q) / dt - last.qd)
        qd[np.abs(qd) < 1e-4] = 0.0  # so that the filter comes to rest bit for bit
        return qd

    def _check_continuity(self, last: JointState, state: JointState, dt: float, gap: bool) -> None:
        """Check for a gap and for a jump between two states whose stamps differ by a time [s]."""
        if gap:
            self.counters["gaps"] += 1
            if dt > STATE_LOSS_TIMEOUT:
                text = f"no joint state for {dt * 1e3:.0f} ms"
                self.fault = Fault(FaultKind.STATES_LOST, text)
        periods = max(1.0, dt / self._period)
        if math.dist(state.positions, last.positions) > self._least_jump * periods:
            moved = np.abs(state.q - last.q)
            excess = moved - self._jumps * periods
            if excess[joint := int(excess.argmax())] > 0.0:
                self.counters["jumps"] += 1
                text = (
                    f"joint {joint + 1} jumped by {moved[joint]:.3f} rad from one state to the next"
                )
                self.fault = self.fault or Fault(FaultKind.JUMP, text)
