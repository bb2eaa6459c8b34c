# SPDX-License-Identifier: Apache-2.0
"""Where the arm is, and how fast, while its states stay away or are not to be believed."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.state_checks import JointState

STANDSTILL = 0.05  # [rad/s] slower than this a joint may be taken to stand still
TORQUE_DELAY = 2  # states until a torque acts: 4 ms, of the 2 to 8 ms of drivers and motors
DIFFERENCED = 4  # states whose rates make a velocity; even, for two drivers in turn
SCATTER = 0.2  # [rad/s] by which these may differ and still be averaged: encoders count
JUMPED = 0.01  # [rad] beside what a joint moves by its speed; more in one state is no motion
FRICTION_STEPS, CREEP = 3, 0.005  # of the model; [rad/s] of a joint that friction holds
FROZEN_SHARE = 0.3  # of the model's speed; a joint seen to move slower than that is not believed
APPROACH = 0.5  # [rad/s] by which a joint that moves approaches where it is said to be
FROZEN_SPEED = 0.1  # [rad/s] of the model, below which a joint may stand still


class Estimate:
    """State of the arm that no single channel can spoil: its model, and how its positions change.

    The velocity channel is not used at all, and of the positions at first only their changes; where
    a joint says it is counts when it moves and nothing contradicts it. A joint that stands still
    although the model has it move is frozen, or has just been stopped by something; the model is
    right in the first case and does no harm in the second.

    Attributes:
        q: Joint positions [rad]. Shape (n,).
        qd: Joint speeds [rad/s]. Shape (n,).

    Args:
        arm: Model of the arm.
        q: Positions to begin with [rad]. Shape (n,).
        qd: Speeds to begin with [rad/s]. Shape (n,).
        sent: Torques that have been sent and do not act yet [N m], the oldest first. Shapes (n,).
    """

    def __init__(
        self, arm: Arm, q: np.ndarray, qd: np.ndarray, sent: Sequence[np.ndarray] = ()
    ) -> None:
        self._arm = arm
        self.q, self.qd = q, qd
        self._sent = deque(sent, maxlen=TORQUE_DELAY + 1)
        self._previous: np.ndarray | None = None  # positions of the last state [rad]
        self._rates: deque[np.ndarray] = deque(maxlen=DIFFERENCED)  # of positions [rad/s]

    def advance(self, tau: np.ndarray, dt: float) -> None:
        """Go on by a time [s] in which a torque (n,) [N m] was sent; it acts later."""
        self._sent.append(tau)
        self.predict(self._sent[0], dt)

    def predict(self, tau: np.ndarray, dt: float) -> None:
        """Let a torque (n,) [N m] act for a time [s]; friction never reverses a motion."""
        arm, qd = self._arm, self.qd
        mass = arm.mass_matrix(self.q)
        momentum = mass.dot(qd) + dt * (tau - arm.bias(self.q, qd) - arm.damping * qd)
        # Implicit, as friction of one joint holds others: that of the wrist's light ones.
        for _ in range(FRICTION_STEPS):
            held = dt * arm.friction / np.maximum(np.abs(qd), CREEP)
            qd = np.linalg.solve(mass + np.diag(held), momentum)
        qd[np.abs(qd) < 1e-6] = 0.0  # so that it comes to rest bit for bit
        self.qd = np.minimum(np.maximum(qd, -arm.qd_max), arm.qd_max)
        self.q = self.q + dt * self.qd

    def follow(self, state: JointState, tau: np.ndarray, believed: bool) -> None:
        """Go on to the next state.

        Args:
            state: Next state.
            tau: Torque that was sent before it [N m]. Shape (n,).
            believed: True for a state that nothing contradicts: a joint that moves is also where it
                says then, and not only as fast.
        """
        before, previous, dt = self.q, self._previous, state.span
        self._previous = state.q
        self.advance(tau, dt)
        if previous is None:
            return
        moved = state.q - previous
        self._rates.append(moved / dt)
        if len(self._rates) < DIFFERENCED:
            return
        qd, speed = _velocity(np.array(self._rates)), np.abs(self.qd)
        seen = (np.abs(qd) >= FROZEN_SHARE * speed) | (speed <= FROZEN_SPEED)
        moved = np.where(np.abs(moved - dt * qd) > JUMPED, dt * qd, moved)
        self.q = np.where(seen, before + moved, self.q)
        self.correct(seen, qd - self.qd)
        if believed:
            most = dt * np.where(seen & (np.abs(qd) > STANDSTILL), APPROACH, 0.0)
            self.q = self.q + np.minimum(np.maximum(state.q - self.q, -most), most)

    def correct(self, seen: np.ndarray, error: np.ndarray) -> None:
        """Correct the speeds of the joints that are seen to move, and so those of the others.

        What is not seen keeps its momentum.

        Args:
            seen: Joints that are seen. Shape (n,).
            error: Error of their speeds [rad/s]. Shape (n,).
        """
        change = np.where(seen, error, 0.0)
        hidden = ~seen & (self.qd != 0.0)
        if hidden.any():
            mass = self._arm.mass_matrix(self.q)
            coupled = mass[hidden].dot(change)
            change[hidden] = -np.linalg.solve(mass[np.ix_(hidden, hidden)], coupled)
        self.qd = self.qd + change


def _velocity(rates: np.ndarray) -> np.ndarray:
    """Speeds of joints whose positions changed at these rates; one change alone is none.

    Args:
        rates: Rates of change of as many states in a row [rad/s]. Shape (4, n).

    Returns:
        [rad/s]. Shape (n,).
    """
    mean = rates.mean(axis=0)
    least, low, high, most = np.sort(rates, axis=0)
    agreed = np.where(
        low * high > 0.0, np.copysign(np.minimum(np.abs(low), np.abs(high)), low), 0.0
    )
    return np.where(most - least > SCATTER + 0.5 * np.abs(mean), agreed, mean)
