# SPDX-License-Identifier: Apache-2.0
"""Estimate of the arm's positions and speeds while joint states are missing or not plausible."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.state_checks import JointState, at_rate
from wam_power_ros.learning.policy import PERIOD

# Numbers of states are those at 500 Hz: at a higher rate they are more, see `at_rate`.
STANDSTILL_SPEED = 0.05  # [rad/s] below this speed a joint may count as standing still
TORQUE_DELAY = 2  # states until a torque acts: 4 ms, of the 2 to 8 ms of drivers and motors
RATE_COUNT = 4  # states whose rates give a velocity; even, for two drivers that alternate
RATE_SPREAD_MAX = 0.2  # [rad/s] largest spread of rates that are averaged: encoder resolution
JUMP_MIN = 0.01  # [rad] larger deviation from the measured speed in one state is a jump
FRICTION_ITERATIONS = 3  # fixed-point iterations of the implicit friction
CREEP_SPEED = 0.005  # [rad/s] speed below which friction holds a joint
FROZEN_SHARE = 0.3  # share of the model's speed; a joint measured below it counts as frozen
FROZEN_SPEED_MIN = 0.1  # [rad/s] below this model speed a joint may stand still
POSITION_CORRECTION_SPEED = 0.5  # [rad/s] at which a moving joint approaches its measured position


class Estimate:
    """State of the arm that no single false channel can corrupt: model plus position changes.

    Velocities are not used at all. Positions are used as long as no state was called false, at
    first only by their changes; the measured position of a joint counts when the joint moves. A
    joint that stands still although the model predicts motion is frozen, or has just been stopped
    by something; the model is right in the first case and does no harm in the second.

    Attributes:
        q: Joint positions [rad]. Shape (n,).
        qd: Joint speeds [rad/s]. Shape (n,).

    Args:
        arm: Model of the arm.
        q: Positions to begin with [rad]. Shape (n,).
        qd: Speeds to begin with [rad/s]. Shape (n,).
        sent: Motor torques commanded that do not act yet [N m], oldest first. Shapes (n,).
        period: Sampling period of the states [s].
    """

    def __init__(
        self,
        arm: Arm,
        q: np.ndarray,
        qd: np.ndarray,
        sent: Sequence[np.ndarray] = (),
        period: float = PERIOD,
    ) -> None:
        self._arm = arm
        self.q, self.qd = q, qd
        self._sent = deque(sent, maxlen=at_rate(TORQUE_DELAY, period) + 1)
        self._previous: np.ndarray | None = None  # positions of the last state [rad]
        self._rate_count = at_rate(RATE_COUNT, period)
        self._rates: deque[np.ndarray] = deque(maxlen=self._rate_count)  # of positions [rad/s]

    def advance(self, tau: np.ndarray, dt: float) -> None:
        """Integrate over a time [s] with a commanded motor torque (n,) [N m]; it acts later."""
        self._sent.append(tau)
        self.predict(self._sent[0], dt)

    def predict(self, tau: np.ndarray, dt: float) -> None:
        """Integrate over a time [s] in which a torque (n,) [N m] acts; friction only brakes."""
        arm, qd = self._arm, self.qd
        mass = arm.mass_matrix(self.q)
        momentum = mass.dot(qd) + dt * (tau - arm.bias(self.q, qd) - arm.damping * qd)
        # Implicit: friction of the light wrist joints also acts on the joints coupled to them.
        for _ in range(FRICTION_ITERATIONS):
            held = dt * arm.friction / np.maximum(np.abs(qd), CREEP_SPEED)
            qd = np.linalg.solve(mass + np.diag(held), momentum)
        qd[np.abs(qd) < 1e-6] = 0.0  # so that it comes to rest bit for bit
        self.qd = np.minimum(np.maximum(qd, -arm.qd_max), arm.qd_max)
        self.q = self.q + dt * self.qd

    def follow(self, state: JointState, tau: np.ndarray, trusted: bool) -> None:
        """Advance to the next state, and correct by its positions if it is trusted.

        Args:
            state: Next state.
            tau: Motor torque commanded before it [N m]. Shape (n,).
            trusted: Whether the state may be used; otherwise the model alone counts.
        """
        before, previous, dt = self.q, self._previous, state.span
        self._previous = state.q
        self.advance(tau, dt)
        if previous is None:
            return
        moved = state.q - previous
        self._rates.append(moved / dt)
        if len(self._rates) < self._rate_count or not trusted:
            return
        qd, speed = _velocity(np.array(self._rates)), np.abs(self.qd)
        observed = (np.abs(qd) >= FROZEN_SHARE * speed) | (speed <= FROZEN_SPEED_MIN)
        moved = np.where(np.abs(moved - dt * qd) > JUMP_MIN, dt * qd, moved)
        self.q = np.where(observed, before + moved, self.q)
        self.correct(observed, qd - self.qd)
        moving = observed & (np.abs(qd) > STANDSTILL_SPEED)
        largest = dt * np.where(moving, POSITION_CORRECTION_SPEED, 0.0)
        self.q = self.q + np.minimum(np.maximum(state.q - self.q, -largest), largest)

    def correct(self, observed: np.ndarray, error: np.ndarray) -> None:
        """Correct the speeds of observed joints; the others keep their momentum.

        Args:
            observed: True for joints whose speed was observed. Shape (n,).
            error: Error of their speeds [rad/s]. Shape (n,).
        """
        change = np.where(observed, error, 0.0)
        hidden = ~observed & (self.qd != 0.0)
        if hidden.any():
            mass = self._arm.mass_matrix(self.q)
            coupled = mass[hidden].dot(change)
            change[hidden] = -np.linalg.solve(mass[np.ix_(hidden, hidden)], coupled)
        self.qd = self.qd + change


def _velocity(rates: np.ndarray) -> np.ndarray:
    """Speeds of joints from the rates of their positions; a single changed rate gives no speed.

    Args:
        rates: Rates of change in consecutive states [rad/s]. Shape (4 or more, n).

    Returns:
        [rad/s]. Shape (n,).
    """
    mean = rates.mean(axis=0)
    lowest, low, *_, high, highest = np.sort(rates, axis=0)
    agreed = np.where(
        low * high > 0.0, np.copysign(np.minimum(np.abs(low), np.abs(high)), low), 0.0
    )
    return np.where(highest - lowest > RATE_SPREAD_MAX + 0.5 * np.abs(mean), agreed, mean)
