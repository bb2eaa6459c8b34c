# SPDX-License-Identifier: Apache-2.0
"""Plausibility of joint states: positions against velocities, and motion against torques.

A joint state may be well formed and false: frozen, of another arm, with another sign or order, or
moved by torques that are not ours. Two checks see that:

* `VelocityCheck`: what a joint has moved is what its velocity adds up to.
* `TorqueCheck`: the arm moves as our torques move it. The residual is that of the observer of the
  generalized momentum [DeLuca2005]: the torque that nothing known explains, low-passed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.estimate import STANDSTILL, TORQUE_DELAY, Estimate
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.learning.rollout import Fault, FaultKind

WINDOW = 0.015  # [s] time constant of the residual
SLIP_WINDOWS = ((0.02, 0.003), (0.1, 0.008))  # [s], [rad] that position and velocity may differ by
SLIP_SHARE = 0.1  # of the motion within the window that may be added
LAG = 0.008  # [s] by which a velocity may be late: between none and this, it is no slip
_SLIP_AT_ONCE = 0.003  # [rad] what one state may add: one state alone is no fault
LATE = 7  # states until a torque shows in velocities: 8 ms of delay, 6 ms of a filter
SUSPECTS = 3  # states in a row beyond a bound that make a fault
REMEMBERED, STRIDE = 100, 4  # states, for the estimate that a fault begins with, and its step
FRESH = 4  # strides that a lie may have lasted when it is found out
FRICTION_SHARE = 2.0  # of a joint's Coulomb friction that may be unexplained
STANDING = 12  # states of the same position, after which a joint stands, without a velocity


class Bound(NamedTuple):
    """Largest torque [N m] that may be unexplained beside friction, shapes (n,).

    Attributes:
        moving: At a joint that moves: what the model may be wrong by.
        standing: At a joint that has reported the same position for some time, bit for bit. It may
            be frozen, and the arm move away under a torque that seems to have no effect.
        inertial: Share of each joint's accelerating torque that may be unexplained beside these
            two, because sensors and motors lag; 0 for none.
    """

    moving: np.ndarray
    standing: np.ndarray
    inertial: float = 0.0


class VelocityCheck:
    """Compares the change of every position with its velocity.

    Args:
        n: Number of joints.
    """

    def __init__(self, n: int) -> None:
        self._n = n
        self.begin()

    def begin(self) -> None:
        """Begin anew: the next state has no predecessor."""
        self._excess = [[0.0] * self._n for _ in SLIP_WINDOWS]
        self._lagged = [0.0] * self._n  # change of position in a period, low-passed [rad]
        self._in_row = 0

    def fault(self, last: JointState, state: JointState, same: Sequence[int]) -> Fault | None:
        """Fault when positions and velocities have contradicted each other for some states.

        Args:
            last: State before.
            state: Present state.
            same: States for which a position has stayed the same, a joint each.
        """
        # Plain floats: half the time of arrays of seven numbers.
        dt = (state.stamp_ns - last.stamp_ns) * 1e-9
        half = 0.5 * dt
        joint, at = -1, 0.0
        gained, lagged = [], []
        keep = math.exp(-dt / LAG)
        channels = (last.q, state.q, last.qd, state.qd)
        rows = zip(*(channel.tolist() for channel in channels), same, self._lagged, strict=True)
        for i, (before, now, qd_before, qd, still, late) in enumerate(rows):
            moved, said = now - before, half * (qd_before + qd)
            late = keep * late + (1.0 - keep) * moved
            lagged.append(late)
            slip = max(min(moved, late) - said, said - max(moved, late), 0.0)
            seen = min(abs(moved), abs(said))
            gained.append(min(slip, _SLIP_AT_ONCE) - SLIP_SHARE * seen)
            if still >= STANDING and abs(qd) > STANDSTILL:
                joint, at = i, slip
        self._lagged = lagged
        for k, (window, bound) in enumerate(SLIP_WINDOWS):
            keep = math.exp(-dt / window)
            excess = [keep * x + gain for x, gain in zip(self._excess[k], gained, strict=True)]
            self._excess[k] = excess
            if (worst := max(excess)) > bound:
                joint, at = excess.index(worst), worst
        self._in_row = self._in_row + 1 if joint >= 0 else 0
        if self._in_row < SUSPECTS:
            return None
        text = f"position and velocity of joint {joint + 1} differ by {at:.3f} rad"
        return Fault(FaultKind.VELOCITY, text)


class TorqueCheck:
    """Torque at every joint that neither the model nor our own torques explain.

    Args:
        arm: Model of the arm.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._allowance = FRICTION_SHARE * arm.friction
        self.begin()

    def begin(self) -> None:
        """Begin anew: nothing is unexplained."""
        self.residual = np.zeros(self._arm.n)
        self._sent: deque[np.ndarray] = deque(maxlen=LATE)
        self._inertial = np.zeros(self._arm.n)  # torque that the motion takes, low-passed [N m]
        self._in_row = 0

    def fault(
        self,
        last: JointState,
        state: JointState,
        same: Sequence[int],
        tau: np.ndarray,
        bound: Bound,
    ) -> Fault | None:
        """Fault when the unexplained torque has exceeded its bound for some states.

        Args:
            last: State before.
            state: Present state.
            same: States for which a position has stayed the same, a joint each.
            tau: Torque at the joints between the two, if it acts at once [N m]. Shape (n,).
            bound: Largest unexplained torque beside friction.
        """
        arm = self._arm
        dt = (state.stamp_ns - last.stamp_ns) * 1e-9
        keep = math.exp(-dt / WINDOW)
        inertial = arm.mass_matrix(state.q).dot(state.qd - last.qd) / dt
        needed = inertial + arm.bias(state.q, state.qd) + arm.resistance(state.qd)
        # When a torque acts is not known, so any between those sent lately explains a motion.
        self._sent.append(tau)
        sent = np.array(self._sent)
        unexplained = needed - np.minimum(np.maximum(needed, sent.min(axis=0)), sent.max(axis=0))
        self.residual = keep * self.residual + (1.0 - keep) * unexplained
        self._inertial = keep * self._inertial + (1.0 - keep) * np.abs(inertial)
        excess = np.abs(self.residual) - bound.inertial * self._inertial
        excess = excess - self._allowance - bound.moving
        if max(same) >= STANDING:
            standing = np.array(same) >= STANDING
            excess = np.where(standing, excess + bound.moving - bound.standing, excess)
        joint = int(excess.argmax())
        self._in_row = self._in_row + 1 if excess[joint] > 0.0 else 0
        if self._in_row < SUSPECTS:
            return None
        text = f"{self.residual[joint]:.1f} N m at joint {joint + 1} are not ours: a contact, "
        text += "a payload, another commander, or a motor that gives less than it is sent"
        return Fault(FaultKind.EXTERNAL_TORQUE, text)


class Plausibility:
    """Decides whether joint states are to be believed, and remembers those before a lie.

    Attributes:
        doubted_ns: Stamp of the last state that contradicted another channel, None without [ns].

    Args:
        arm: Model of the arm.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._velocity, self._torque = VelocityCheck(arm.n), TorqueCheck(arm)
        self._past: deque[_Past] = deque(maxlen=REMEMBERED)
        self.doubted_ns: int | None = None
        self.begin()

    def begin(self) -> None:
        """Begin anew: the next state has no predecessor."""
        self._past.clear()
        self._led = False  # by a person, whose force nobody knows
        self._same = [0] * self._arm.n  # states for which a position has stayed the same
        self._velocity.begin()
        self._torque.begin()

    def fault(
        self, last: JointState | None, state: JointState, tau: np.ndarray, bound: Bound | None
    ) -> Fault | None:
        """Fault of a state that contradicts what else is known; None for one that does not.

        Args:
            last: State before, None when it is too long ago to compare with.
            state: Present state.
            tau: Torque at the joints between the two [N m]. Shape (n,).
            bound: Largest unexplained torque beside friction, None when a person moves the arm.
        """
        if last is None:
            self.begin()
            return None
        positions = zip(self._same, last.q.tolist(), state.q.tolist(), strict=True)
        same = self._same = [count + 1 if now == before else 0 for count, before, now in positions]
        fault = self._velocity.fault(last, state, same)
        self._led = bound is None
        if bound is None:
            self._torque.begin()
        else:
            fault = fault or self._torque.fault(last, state, same, tau, bound)
        if fault is not None:
            self.doubted_ns = state.stamp_ns
        self._past.append(_Past(last.q, last.qd, tau, state.span))
        return fault

    def estimate(self, last: JointState, lie: int = FRESH * STRIDE) -> Estimate:
        """Where the arm is: what has been seen to move where it was seen, the rest by its model.

        Args:
            last: Last state.
            lie: Number of the last states that may be false.
        """
        past = list(self._past)
        first = past[0] if past else last
        taus = [each.tau for each in past]
        acting = taus[:1] * TORQUE_DELAY + taus
        found = Estimate(self._arm, first.q, first.qd, acting[len(taus) :])
        marks = np.array([each.q for each in past[::STRIDE]] + [last.q])
        moved = np.diff(marks, axis=0)
        for k in range(len(moved)):
            some = slice(k * STRIDE, (k + 1) * STRIDE)
            dt = sum(each.dt for each in past[some])
            fresh = (len(moved) - k) * STRIDE <= lie
            if fresh and self._led:
                found.q = found.q + dt * found.qd
                continue
            qd = found.qd
            found.predict(np.mean(acting[some], axis=0), dt)
            if not fresh:
                # Within the stride in which it froze a joint has moved too little.
                after = moved[min(k + 1, len(moved) - 1)]
                goes_on = np.abs(after) > 0.5 * np.abs(moved[k])
                seen = (np.abs(moved[k]) > STANDSTILL * dt) & goes_on
                found.q = np.where(seen, marks[k + 1], found.q)
                found.correct(seen, moved[k] / dt - 0.5 * (qd + found.qd))
        return found


class _Past(NamedTuple):
    """A joint state, and the torque that acted for a time after it."""

    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray
    dt: float
