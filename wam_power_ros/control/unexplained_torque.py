# SPDX-License-Identifier: Apache-2.0
"""Torque that holds the arm at rest beyond what the model says.

A payload, a tilted base, wrong zeros or a weak motor: what they need in addition to g(q) is known
once the arm has been held at rest. Friction hides up to its own size of it.
"""

from __future__ import annotations

import math

import numpy as np

from wam_power_ros.control.arm import Arm

KNOWN_AFTER = 0.1  # [s] at rest until the torque is known
TIME_CONSTANT = 0.05  # [s] of its low-pass: feedback that is still settling counts little
NEGLIGIBLE_SHARE = 0.01  # of a joint's friction: rounding errors of the model are below
FADE_RANGE = 0.05  # [rad] from the posture where the arm was held, to where that tells nothing
STEP = 0.0015  # [rad] change in one state beyond its velocity: the arm was put elsewhere
FRICTION_FACTOR = 1.5  # multiple of a joint's friction up to which friction may explain it
TORQUE_SHARE = 0.005  # share of a joint's torque limit added to that: resolution of the torques


class UnexplainedTorque:
    """Measures, while the arm is held, the torque beyond the model.

    Attributes:
        torque: Low-passed torque beyond g(q) [N m]. Shape (n,).
        compensation: Torque to add to g(q) in any posture: `torque` at the joints where it exceeds
            the friction, so that the model is wrong for certain, else zero [N m]. Shape (n,).
        known: Whether the arm has been held at rest for `KNOWN_AFTER` since `begin`.
    """

    def __init__(self, arm: Arm) -> None:
        self._names = arm.joint_names
        self._friction, self._negligible = arm.friction, NEGLIGIBLE_SHARE * arm.friction
        self._explained = FRICTION_FACTOR * arm.friction + TORQUE_SHARE * arm.tau_max
        self._n = arm.n
        self.begin()

    def begin(self) -> None:
        """Forget what was measured: a driver or a person has held the arm since."""
        self.torque = np.zeros(self._n)
        self.compensation = np.zeros(self._n)
        self.known = False
        self._rested = 0.0  # time at rest so far [s]
        self._held_at: np.ndarray | None = None  # posture of the last observation at rest [rad]

    def observe(self, at_rest: bool, q: np.ndarray, beyond: np.ndarray, dt: float) -> None:
        """Register a state of the held arm.

        Args:
            at_rest: Whether the arm was at rest.
            q: Joint positions [rad]. Shape (n,).
            beyond: Motor torque commanded, minus g(q) [N m]. Shape (n,).
            dt: Time since the last call [s].
        """
        if not at_rest:
            self._rested = 0.0
            return
        self._rested += dt
        share = 1.0 - math.exp(-dt / TIME_CONSTANT)
        self.torque = self.torque + share * (beyond - self.torque)
        certain = np.abs(self.torque) > self._friction
        self.compensation = np.where(certain, self.torque, np.zeros(self._n))
        self._held_at = q
        self.known = self.known or self._rested >= KNOWN_AFTER

    def guided(self, q: np.ndarray, step: float) -> np.ndarray:
        """Torque to add to g(q) while a person guides the arm [N m]. Shape (n,).

        Where the arm was held it is the torque that held it: then friction goes on holding it. Away
        from there, and when it comes back, friction had a share in it that is not known, so only
        `compensation` is left.

        Args:
            q: Joint positions [rad]. Shape (n,).
            step: Largest change of a position in the last state beyond that of its velocity [rad].
        """
        if self._held_at is None:
            return self.compensation
        share = 1.0 - float(np.abs(q - self._held_at).max()) / FADE_RANGE
        if share <= 0.0 or step > STEP:
            self._held_at = None  # also when the arm comes back
            return self.compensation
        held = np.where(np.abs(self.torque) > self._negligible, self.torque, 0.0)
        return self.compensation + share * (held - self.compensation)

    def excess(self) -> str:
        """Joints whose unexplained torque no friction explains, as text; empty without any."""
        rows = zip(self._names, self.torque.tolist(), self._explained.tolist(), strict=True)
        return ", ".join(
            f"{name}: {torque:.1f} N m unexplained (friction explains {explained:.1f})"
            for name, torque, explained in rows
            if abs(torque) > explained
        )
