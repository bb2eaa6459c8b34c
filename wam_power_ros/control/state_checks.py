# SPDX-License-Identifier: Apache-2.0
"""Checks of joint states before anything is computed from them: stamps, values and continuity."""

import enum
import math
from collections import Counter, deque
from typing import NamedTuple

import numpy as np

from wam_power_ros.learning.rollout import Fault, FaultKind

STATES_LOST_AFTER = 0.02  # [s] without a joint state: the next one, or the watchdog, is a fault
IMPLAUSIBLE_Q = 20.0  # [rad] no joint gets here: a reading beyond is refused
IMPLAUSIBLE_QD = 500.0  # [rad/s]
Q_JUMP = 0.1  # [rad] change of a joint from one state to the next that means another zero
_REFUSALS, _WINDOW = 5, 50  # so many refused states within so many states are a fault
_INTEGERS = (int, np.integer)


class Unanswered(enum.Enum):
    """Why a joint state was not accepted."""

    REPEATED = "repeated"  # the last accepted state once more
    REFUSED = "refused"


class JointState(NamedTuple):
    """A joint state that was accepted.

    Attributes:
        stamp_ns: Stamp of the driver's header [ns].
        q: Joint positions [rad]. Shape (n,).
        qd: Joint speeds [rad/s]. Shape (n,).
        dt: Time since the state before came, by our own clock where there is one; at most twice the
            period [s].
        span: Time in which the arm moved from there: stamps may be too slow, and states that were
            held up come at once, so the longer one counts; at most twice the period [s].
    """

    stamp_ns: int
    q: np.ndarray
    qd: np.ndarray
    dt: float
    span: float


def plausible(values: list[float], bound: float) -> bool:
    """Whether every value is finite and of a size a joint can have.

    Args:
        values: Positions [rad] or speeds [rad/s].
        bound: IMPLAUSIBLE_Q or IMPLAUSIBLE_QD.
    """
    if math.hypot(*values) < bound:  # none is longer than all together; false for a NaN
        return True
    # The sum, because every comparison with a NaN is false.
    return math.isfinite(sum(values)) and -bound < min(values) and max(values) < bound


class StateChecks:
    """Accepts or refuses joint states, and estimates velocities that a driver does not send.

    Attributes:
        counters: Number of states `accepted`, `repeated`, `older`, `rejected`; of `gaps`, `jumps`.
        last: Last accepted state, None before the first.
        before: State accepted before that one; None when there was none, or a gap between them.
        fault: Fault that the last state gives rise to, None without.
        refused_in_row: Number of states refused since the last accepted one.

    Args:
        n: Number of joints.
        period: Sampling period of the states [s].
        velocity_cutoff: Cut-off of the low-pass for differentiated positions [rad/s].
    """

    def __init__(self, n: int, period: float, velocity_cutoff: float) -> None:
        self.counters: Counter[str] = Counter()
        self.last: JointState | None = None
        self.before: JointState | None = None
        self.fault: Fault | None = None
        self.refused_in_row = 0
        self._n, self._period, self._cutoff = n, period, velocity_cutoff
        self._gap_ns = 3 * round(period * 1e9)  # later than that: never differentiated across
        self._count = 0  # states so far
        self._refusals: deque[int] = deque(maxlen=_REFUSALS)  # counts at which states were refused

    def take(
        self, stamp_ns: object, q: object, qd: object, restart: bool, elapsed: float | None = None
    ) -> JointState | Unanswered:
        """Check one joint state.

        Args:
            stamp_ns: Stamp of the driver's header [ns].
            q: Joint positions [rad]. Shape (n,).
            qd: Joint speeds, None when the driver does not send them [rad/s]. Shape (n,).
            restart: Whether an older stamp means that the driver has started again.
            elapsed: Time since the last accepted state by a clock of our own, None to go by the
                stamps [s].
        """
        self._count += 1
        self.fault = None
        if not isinstance(stamp_ns, _INTEGERS):
            return self._refuse("rejected")
        stamp_ns, last = int(stamp_ns), self.last
        if last is not None and stamp_ns == last.stamp_ns:
            self.counters["repeated"] += 1
            return Unanswered.REPEATED
        if last is not None and stamp_ns < last.stamp_ns:
            if not restart:
                return self._refuse("older")
            last = None
        positions = self._read(q, IMPLAUSIBLE_Q)
        if positions is None:
            return self._refuse("rejected")
        given = self._velocity(last, stamp_ns, positions) if qd is None else qd
        speeds = self._read(given, IMPLAUSIBLE_QD)
        if speeds is None:
            return self._refuse("rejected")
        self.counters["accepted"] += 1
        self.refused_in_row = 0
        advanced = self._check_continuity(last, stamp_ns, positions)
        dt, most = advanced if elapsed is None else elapsed, 2.0 * self._period
        span = min(max(advanced, dt), most)
        gap = last is None or stamp_ns - last.stamp_ns > self._gap_ns
        self.before = None if gap else last
        self.last = JointState(stamp_ns, positions, speeds, min(dt, most), span)
        return self.last

    def refuse(self) -> None:
        """Count a joint state that could not be read, as one that `take` refuses."""
        self._count += 1
        self.fault = None
        self._refuse("rejected")

    def _refuse(self, counter: str) -> Unanswered:
        self.counters[counter] += 1
        self.refused_in_row += 1
        refusals = self._refusals
        refusals.append(self._count)
        if len(refusals) == _REFUSALS and self._count - refusals[0] < _WINDOW:
            self.fault = Fault(FaultKind.STATES_REFUSED, "five joint states refused within 50")
        return Unanswered.REFUSED

    def _read(self, values: object, bound: float) -> np.ndarray | None:
        """A copy of a joint vector; None when it is not one, not finite or impossibly large."""
        try:
            array = np.array(values, dtype=float)
        except (TypeError, ValueError):
            return None
        if array.shape != (self._n,) or not plausible(array.tolist(), bound):
            return None
        return array

    def _velocity(self, last: JointState | None, stamp_ns: int, q: np.ndarray) -> np.ndarray:
        """Differentiated and low-passed position; kept as it is across a gap."""
        if last is None:
            return np.zeros(self._n)
        if stamp_ns - last.stamp_ns > self._gap_ns:
            return last.qd
        dt = (stamp_ns - last.stamp_ns) * 1e-9
        share = 1.0 - math.exp(-self._cutoff * dt)
        qd = last.qd + share * ((q - last.q) / dt - last.qd)
        qd[np.abs(qd) < 1e-4] = 0.0  # so that the filter comes to rest bit for bit
        return qd

    def _check_continuity(self, last: JointState | None, stamp_ns: int, q: np.ndarray) -> float:
        """Look for a gap and for a jump; returns the advance of the stamp [s]."""
        if last is None:
            return self._period
        dt = (stamp_ns - last.stamp_ns) * 1e-9
        if stamp_ns - last.stamp_ns > self._gap_ns:
            self.counters["gaps"] += 1
            if dt > STATES_LOST_AFTER:
                text = f"no joint state for {dt * 1e3:.0f} ms"
                self.fault = Fault(FaultKind.STATES_LOST, text)
        allowed = Q_JUMP * max(1.0, dt / self._period)
        if math.dist(q.tolist(), last.q.tolist()) > allowed:  # no joint went farther than that
            jump = max(map(abs, (q - last.q).tolist()))
            if jump > allowed:
                self.counters["jumps"] += 1
                text = f"a joint jumped by {jump:.3f} rad from one state to the next"
                self.fault = self.fault or Fault(FaultKind.JUMP, text)
        return dt
