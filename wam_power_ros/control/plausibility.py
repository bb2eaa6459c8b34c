# SPDX-License-Identifier: Apache-2.0
"""Plausibility checks of joint states: positions against velocities, motion against torques.

A joint state may be well formed and still false: frozen, of another arm, with a wrong sign or
joint order. The arm may also be moved by torques of another source. Two checks detect this:

* `VelocityCheck`: the change of each position agrees with the integral of its velocity.
* `TorqueCheck`: the motion agrees with the commanded torques. Its residual is that of the
  generalized-momentum observer [DeLuca2005]: the low-passed torque that nothing known explains.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from wam_power_ros import compiled
from wam_power_ros.control.arm import FRICTION_SPEED, Arm
from wam_power_ros.control.state_checks import JointState, at_rate
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.policy import PERIOD

# Numbers of states are those at 500 Hz: at a higher rate they are more, see `at_rate`.
RESIDUAL_TIME_CONSTANT = 0.015  # [s]
MISMATCH_WINDOWS = ((0.02, 0.003), (0.1, 0.008))  # [s] time constant, [rad] bound on the mismatch
MISMATCH_SHARE = 0.1  # share of the motion within a window that is added to the bound
VELOCITY_LAG = 0.018  # [s] largest delay of a velocity that does not count as a mismatch
STAMP_WINDOW = 8  # states over which stamps are averaged: single ones jitter
REPEATS_MAX = 1  # states that may repeat the one before: a driver may publish each twice
_MISMATCH_PER_STATE = 0.003  # [rad] largest mismatch that one state adds: one alone is no fault
_LEAP = 0.015  # [rad] beyond the velocity's in one state, too much for a lag: 7.5 rad/s
LATENCY_STATES = 7  # states until a torque shows in velocities: 8 ms of delay, 6 ms of a filter
CONTRADICTIONS_TO_FAULT = 3  # consecutive states beyond a bound that are a fault
STEP_FACTOR = 2.0  # multiple of a joint's full torque beyond which a change of speed is a step
STANDSTILL_SPEED = 0.05  # [rad/s] below this speed a joint may count as standing still
FRICTION_FACTOR = 2.0  # multiple of a joint's Coulomb friction that may be unexplained
STANDSTILL_STATES = 12  # states with the same position after which a joint stands still


class Bound(NamedTuple):
    """Bound on the torque residual in addition to friction [N m].

    Attributes:
        moving: At a moving joint: error of the model. Shape (n,).
        standing: At a joint that has reported the same position for `STANDSTILL_STATES`, bit for
            bit. Its position may be frozen while the arm moves away under a torque that seems to
            have no effect. Shape (n,).
        inertial: Share of each joint's accelerating torque that is added to these, because sensors
            and motors lag; 0 for none.
    """

    moving: np.ndarray
    standing: np.ndarray
    inertial: float = 0.0


class Interval(NamedTuple):
    """Time between two states [s], whose stamps may jitter around the times of measurement.

    Attributes:
        mean: Averaged over `STAMP_WINDOW` states.
        shortest: Shorter one of this and the difference of the stamps.
        longest: Longer one.
    """

    mean: float
    shortest: float
    longest: float


class VelocityCheck:
    """Compares the change of every position with its velocity."""

    def __init__(self, n: int, period: float = PERIOD) -> None:
        self._n = n
        self._to_fault = at_rate(CONTRADICTIONS_TO_FAULT, period)
        self._standstill = at_rate(STANDSTILL_STATES, period)
        self._leap = _LEAP * min(1.0, period / PERIOD)
        self._constants = (
            *(VELOCITY_LAG, self._leap, _MISMATCH_PER_STATE, MISMATCH_SHARE),
            *(float(self._standstill), STANDSTILL_SPEED, *sum(MISMATCH_WINDOWS, ())),
        )
        self.begin()

    def begin(self) -> None:
        """Restart: the next state has no predecessor."""
        self._mismatch = [[0.0] * self._n for _ in MISMATCH_WINDOWS]
        self._lagged = [0.0] * self._n  # change of position in a period, low-passed [rad]
        self._moved = [0.0] * self._n  # change of position before the last state [rad]
        self._in_row = 0

    def fault(
        self, last: JointState, state: JointState, unchanged: Sequence[int], interval: Interval
    ) -> Fault | None:
        """Fault when positions and velocities contradict each other in consecutive states.

        Args:
            unchanged: Number of states for which each joint's position has stayed the same.
        """
        states = last.positions, state.positions, last.speeds, state.speeds
        kept = unchanged, self._lagged, self._moved
        if compiled.kernel is not None:
            new = compiled.kernel.velocity_check(
                *states, *kept, self._mismatch, *interval, self._constants
            )
            if new is not None:
                self._lagged, self._moved, self._mismatch = new
                self._in_row = 0
                return None
        before, now, qd_before, qd = map(np.array, states)
        repeats, late, previous = map(np.array, kept)
        dt, short, long = interval
        keep = math.exp(-dt / VELOCITY_LAG)
        moved, speeds = now - before, qd_before + qd
        late = keep * late + (1.0 - keep) * moved
        self._lagged, self._moved = late.tolist(), moved.tolist()
        least, most = np.sort([0.5 * short * speeds, 0.5 * long * speeds], axis=0)
        too_far, too_short = np.minimum(moved, late) - most, least - np.maximum(moved, late)
        size_moved, slow = np.abs(moved), 0.5 * short * np.abs(speeds)
        back = np.minimum(size_moved, np.abs(previous))  # and forth, which no lag explains
        leap = _MISMATCH_PER_STATE * (np.abs(moved - most) > self._leap)
        mismatch = np.maximum(np.maximum(too_far, too_short), leap)
        mismatch = np.maximum(mismatch, np.where(moved * previous < 0.0, back, 0.0))
        added = np.minimum(mismatch, _MISMATCH_PER_STATE)
        added -= MISMATCH_SHARE * np.minimum(size_moved, slow)
        stuck = np.flatnonzero((repeats >= self._standstill) & (np.abs(qd) > STANDSTILL_SPEED))
        joint = int(stuck[-1]) if len(stuck) else -1
        size = mismatch[joint]
        for k, (window, bound) in enumerate(MISMATCH_WINDOWS):
            sums = math.exp(-dt / window) * np.array(self._mismatch[k]) + added
            self._mismatch[k] = sums.tolist()
            if sums.max() > bound:
                joint = int(sums.argmax())
                size = sums[joint]
        self._in_row = self._in_row + 1 if joint >= 0 else 0
        if self._in_row < self._to_fault:
            return None
        text = f"position and velocity of joint {joint + 1} differ by {size:.3f} rad"
        return Fault(FaultKind.VELOCITY, text)


class TorqueCheck:
    """Compares the motion with the commanded torques, by the residual of every joint.

    Attributes:
        residual: Low-passed torque that neither the model nor the commands explain [N m].
            n numbers.
    """

    def __init__(self, arm: Arm, period: float = PERIOD) -> None:
        self._arm = arm
        self._latency = at_rate(LATENCY_STATES, period)
        self._to_fault = at_rate(CONTRADICTIONS_TO_FAULT, period)
        self._standstill = at_rate(STANDSTILL_STATES, period)
        self._full_torque = (STEP_FACTOR * arm.tau_max).tolist()
        self._allowance = (FRICTION_FACTOR * arm.friction).tolist()
        self._constants = (
            *(RESIDUAL_TIME_CONSTANT, FRICTION_SPEED, float(self._standstill)),
            *(arm.friction.tolist(), arm.damping.tolist(), self._full_torque, self._allowance),
        )
        self.begin()

    def begin(self) -> None:
        """Restart with a residual of zero."""
        self.residual = [0.0] * self._arm.n
        self._inertial = [0.0] * self._arm.n  # accelerating torque, low-passed [N m]
        self._sent: np.ndarray | None = None  # latest torques, in any order: (states, n) [N m]
        self._row = 0  # of the oldest of them
        self._in_row = 0

    def fault(
        self,
        last: JointState,
        state: JointState,
        unchanged: Sequence[int],
        tau: np.ndarray,
        bound: Bound,
        dt: float,
    ) -> Fault | None:
        """Fault when the residual exceeds its bound in consecutive states.

        Args:
            unchanged: Number of states for which each joint's position has stayed the same.
            tau: Motor torque commanded between the two [N m]. Shape (n,).
            dt: Time between the two [s].
        """
        arm = self._arm
        mass = arm.mass_matrix(state.q)
        state.bias = bias = arm.bias(state.q, state.qd)
        # The delay from command to torque is unknown, so a motion counts as explained by any torque
        # within the range of those sent in the last LATENCY_STATES states.
        sent = self._sent_with(tau)
        moving, lag = bound.moving.tolist(), bound.inertial
        if compiled.kernel is not None:
            given = last.speeds, state.speeds, unchanged, self.residual, self._inertial
            bounds = moving, bound.standing.tolist(), lag
            new = compiled.kernel.torque_check(
                mass, bias, sent, *given, *bounds, dt, self._constants
            )
            if new is not None:
                self.residual, self._inertial, stepped = new
                self._in_row = 0
                return self._step(state) if stepped and not state.derived else None
        keep = math.exp(-dt / RESIDUAL_TIME_CONSTANT)
        accelerating = mass.dot(state.qd - last.qd) / dt
        # The same in both directions, as in the compiled loop: the bounds have room for more.
        friction = arm.friction * np.tanh(state.qd / FRICTION_SPEED) + arm.damping * state.qd
        needed = accelerating + bias + friction
        low, high = np.minimum.reduce(sent), np.maximum.reduce(sent)
        beyond = needed - np.minimum(np.maximum(needed, low), high)
        torque = np.abs(accelerating)
        stepped = bool((torque > self._full_torque).any())
        residual = keep * np.array(self.residual) + (1.0 - keep) * beyond
        size = keep * np.array(self._inertial) + (1.0 - keep) * torque
        self.residual, self._inertial = residual.tolist(), size.tolist()
        more = np.where(np.array(unchanged) >= self._standstill, bound.standing, bound.moving)
        excess = np.abs(residual) - lag * size - self._allowance - more
        joint = int(excess.argmax())
        self._in_row = self._in_row + 1 if excess[joint] > 0.0 else 0
        if stepped and not state.derived:
            return self._step(state)
        if self._in_row < self._to_fault:
            return None
        text = f"{self.residual[joint]:.1f} N m at joint {joint + 1} are not explained by the "
        text += "commanded torques: a contact, a payload, another commander, or a motor that gives "
        return Fault(FaultKind.EXTERNAL_TORQUE, f"{text}less than commanded")

    def _step(self, state: JointState) -> Fault:
        text = f"a speed changed within one state, to {np.abs(state.qd).max():.2f} rad/s, by more "
        return Fault(FaultKind.VELOCITY, f"{text}than {STEP_FACTOR:.0f} times the full torque can")

    def _sent_with(self, tau: np.ndarray) -> np.ndarray:
        """Torques sent in the last states, this one included, in any order: (states, n) [N m]."""
        if self._sent is None:
            self._sent = np.tile(tau, (self._latency, 1))
        self._sent[self._row] = tau
        self._row = (self._row + 1) % self._latency
        return self._sent


class Plausibility:
    """Runs both checks.

    Attributes:
        implausible_ns: Stamp of the last state that failed a check [ns], None before the first.
    """

    def __init__(self, arm: Arm, period: float = PERIOD) -> None:
        self._arm, self._period = arm, period
        self._velocity, self._torque = VelocityCheck(arm.n, period), TorqueCheck(arm, period)
        self.implausible_ns: int | None = None
        self.begin()

    def begin(self) -> None:
        """Restart: the next state has no predecessor."""
        window = at_rate(STAMP_WINDOW, self._period)
        self._stamps: deque[int] = deque(maxlen=window)  # of the latest states [ns]
        self._checked: JointState | None = None  # last state that did not repeat the one before
        self._repeats = 0  # states that repeat the one before, up to the last
        self._skipped = 0  # states since the last one that was checked
        self._unchanged = [0] * self._arm.n  # states for which each position has stayed the same
        self._velocity.begin()
        self._torque.begin()

    def let_go(self) -> None:
        """Forget the torque of a person who guided the arm."""
        self._torque.begin()

    @property
    def residual(self) -> list[float]:
        """Low-passed torque that neither the model nor the commands explain [N m]. n numbers."""
        return self._torque.residual

    def fault(
        self, last: JointState | None, state: JointState, tau: np.ndarray, bound: Bound
    ) -> Fault | None:
        """Fault of a state that fails a plausibility check, or None.

        Args:
            last: Previous state, None when it is too long ago to compare with.
            tau: Motor torque commanded between the two [N m]. Shape (n,).
        """
        if last is None:
            self.begin()
            return None
        self._unchanged = _standing(self._unchanged, last.positions, state.positions)
        fault = None
        if self._repeated(last, state):
            self._skipped += 1
        else:
            fault = self._contradiction(self._checked or last, state, tau, bound)
            self._checked, self._skipped = state, 0
        if fault is not None:
            self.implausible_ns = state.stamp_ns
        return fault

    def _repeated(self, last: JointState, state: JointState) -> bool:
        """Whether a state repeats the one before under another stamp, as few have before it."""
        if not self._stamps:
            self._stamps.append(last.stamp_ns)
        self._stamps.append(state.stamp_ns)
        same = min(self._unchanged) > 0 and last.speeds == state.speeds
        moving = same and max(map(abs, state.speeds)) > STANDSTILL_SPEED
        self._repeats = self._repeats + 1 if moving else 0
        return 0 < self._repeats <= REPEATS_MAX

    def _contradiction(
        self, last: JointState, state: JointState, tau: np.ndarray, bound: Bound
    ) -> Fault | None:
        """Fault of either check; arguments as for `fault`."""
        stamps = self._stamps
        mean = (self._skipped + 1) * (stamps[-1] - stamps[0]) * 1e-9 / (len(stamps) - 1)
        dt = (state.stamp_ns - last.stamp_ns) * 1e-9
        interval = Interval(mean, min(dt, mean), max(dt, mean))
        fault = self._velocity.fault(last, state, self._unchanged, interval)
        return fault or self._torque.fault(
            last, state, self._unchanged, tau, bound, interval.longest
        )


def _standing(counts: list[int], before: list[float], now: list[float]) -> list[int]:
    """Count on for how many states each position has stayed the same."""
    rows = zip(counts, before, now, strict=True)
    return [count + 1 if x == previous else 0 for count, previous, x in rows]
