# SPDX-License-Identifier: Apache-2.0
"""Torque that holds the arm at rest beyond what the model says.

A payload, a tilted base, wrong zeros or a weak motor: what they need in addition to g(q) is known
once the arm has been held at rest. Friction hides up to its own size of it.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from wam_power_ros.control.arm import Arm

KNOWN_AFTER = 0.1  # [s] at rest until the torque is known
TIME_CONSTANT = 0.05  # [s] of its low-pass: feedback that is still settling counts little
NEGLIGIBLE_SHARE = 0.01  # of a joint's friction: rounding errors of the model are below
PAST_OBSERVATIONS = 20  # the first is from before a lie or a contact was found: 0.2 s
FADE_RANGE = 0.05  # [rad] from the posture where the arm was held, to where that tells nothing
STEP = 0.0015  # [rad] change in one state beyond its velocity: the arm was put elsewhere
FRICTION_FACTOR = 1.5  # multiple of a joint's friction up to which friction may explain it
SETTLED_AFTER = 0.5  # [s] without motion until the torque that holds the arm must stay the same
MOTION = 0.02  # [rad/s] reported speed from which a joint counts as moved, by a hand say
CREEP_FACTOR, CREEP_SHARE = 0.75, 0.01  # by how much it may change: of the friction, of the limit
STILL_BEFORE = 0.04  # [s] without motion before one begins; else it is still the one before
OVERCOME = 0.5  # of its friction: a change of the torque that may have moved a joint
SLIP_SHARE, COUPLED_SHARE = 0.25, 0.5  # of friction, see `_friction_in`
TORQUE_SHARE = 0.005  # share of a joint's torque limit added to that: resolution of the torques


class UnexplainedTorque:
    """Measures, while the arm is held, the torque beyond the model.

    Attributes:
        torque: Low-passed torque beyond g(q) [N m]. Shape (n,).
        compensation: Torque to add to g(q) in any posture: `torque` at the joints where it exceeds
            the friction, so that the model is wrong for certain, else zero [N m]. Shape (n,).
        known: Whether the arm has been held at rest for `KNOWN_AFTER` since `begin`.
        crept: How the torque has changed although the arm reports rest, so that a zero drifts and
            the arm follows it; empty if it has not.
        drift: Speeds that joints reported when it began, and against which the arm moves since
            then, at rest by its states [rad/s]. Shape (n,).
    """

    def __init__(self, arm: Arm) -> None:
        self._names = arm.joint_names
        self._friction = np.maximum(arm.friction, 1e-9)  # divides
        self._negligible = NEGLIGIBLE_SHARE * arm.friction
        self._creep = CREEP_FACTOR * arm.friction + CREEP_SHARE * arm.tau_max
        self._explained = FRICTION_FACTOR * arm.friction + TORQUE_SHARE * arm.tau_max
        self._n = arm.n
        self.begin()

    def begin(self) -> None:
        """Forget what was measured: a driver or a person has held the arm since."""
        self.torque = np.zeros(self._n)
        self.compensation = np.zeros(self._n)
        self.known = False
        self._rested = 0.0  # time at rest so far [s]
        self._still: float  # time without motion so far [s]
        self._settled: np.ndarray | None  # torque after SETTLED_AFTER without motion [N m]
        self._latest: np.ndarray | None  # torque of the last state [N m]
        self._before: np.ndarray | None  # the same before this motion
        self._drag: np.ndarray  # torque that has overcome a joint's friction in this motion [N m]
        self._mover: int | None  # this joint
        self.rest_again()
        self._past: deque[np.ndarray] = deque([self.torque], maxlen=PAST_OBSERVATIONS)
        self._held_at: np.ndarray | None = None  # posture of the last observation at rest [rad]

    def rest_again(self) -> None:
        """Compare with the torque of the next rest: what has changed is said, or the arm moved."""
        self.crept, self._still = "", 0.0
        self._settled = self._latest = self._before = self._mover = None
        self.drift = self._drag = np.zeros(self._n)

    def assume(self, q: np.ndarray, model_error: np.ndarray) -> None:
        """Begin with a torque (n,) [N m] beyond g(q) that holds the arm at q (n,) [rad]."""
        self.torque, self._held_at = model_error, q
        self._past = deque([model_error], maxlen=PAST_OBSERVATIONS)

    def observe(
        self, at_rest: bool, q: np.ndarray, qd: np.ndarray, model_error: np.ndarray, dt: float
    ) -> None:
        """Register a state of the held arm.

        Args:
            q: Joint positions [rad]. Shape (n,).
            qd: Reported speeds [rad/s]. Shape (n,).
            beyond: Motor torque commanded, minus g(q) [N m]. Shape (n,).
            dt: Time since the last call [s].
        """
        self._watch(qd, model_error, dt)
        if not at_rest:
            self._rested = 0.0
            return
        self._rested += dt
        if self.crept:
            return
        share = 1.0 - math.exp(-dt / TIME_CONSTANT)
        self.torque = self.torque + share * (model_error - self.torque)
        self._past.append(self.torque)
        certain = np.abs(self.torque) > self._friction
        self.compensation = np.where(certain, self.torque, np.zeros(self._n))
        self._held_at = q
        self.known = self.known or self._rested >= KNOWN_AFTER

    def _watch(self, qd: np.ndarray, model_error: np.ndarray, dt: float) -> None:
        """Notice a torque that changes while no joint reports a motion."""
        moves = np.abs(qd) >= MOTION
        if moves.any():
            if self._still >= STILL_BEFORE:  # a motion begins
                self._before, self._settled, self._mover = self._latest, None, None
                self.drift = self._drag = np.zeros(self._n)
            if self._before is not None:
                self._resist(qd, moves, model_error - self._before)
        self._still = 0.0 if moves.any() else self._still + dt
        self._latest = model_error
        if self._still < SETTLED_AFTER:
            return
        if self._settled is None:
            self._settled = model_error
        change = model_error - self._settled
        excess = np.abs(change) - self._creep
        if excess[joint := int(excess.argmax())] > 0.0:
            self.crept = (
                f"the torque that holds joint {joint + 1} has changed by {change[joint]:.1f} N m, "
                "and no joint reports a motion: its zero drifts, or something leans on the arm"
            )
            self.compensation = model_error - self._friction_in(change)
            self._past = deque([self.compensation], maxlen=PAST_OBSERVATIONS)

    def _resist(self, qd: np.ndarray, moves: np.ndarray, change: np.ndarray) -> None:
        """Register how the torque (n,) [N m] has changed in a motion that joints report."""
        self.drift = np.where(moves & (np.abs(qd) > np.abs(self.drift)), qd, self.drift)
        share = np.where(moves, np.abs(change) / self._friction, 0.0)
        joint = int(share.argmax())
        if share[joint] > max(OVERCOME, float(np.abs(self._drag / self._friction).max())):
            self._mover, self._drag = joint, change

    def _friction_in(self, change: np.ndarray) -> np.ndarray:
        """Share of friction (n,) [N m] in the torque of an arm that follows a drift, at rest.

        The joint that was seen to move is moved against its friction. The hold couples the joints:
        where its share of that exceeded the friction of another one, this one slipped. Half of the
        share still presses there, and friction opposes the slip, whose torque changes since then.
        """
        if (mover := self._mover) is None:
            return np.zeros(self._n)
        drag = self._drag * (self._friction[mover] / abs(self._drag[mover]))
        limit = SLIP_SHARE * self._friction
        slip = COUPLED_SHARE * drag - np.minimum(np.maximum(change, -limit), limit)
        slip[np.abs(self._drag) <= self._friction] = 0.0
        slip[mover] = drag[mover]
        return slip

    def teaching_offset(self, q: np.ndarray, step: float) -> np.ndarray:
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

    def before(self, q: np.ndarray) -> np.ndarray:
        """Torque beyond g(q) that held a resting arm before anything happened [N m]. Shape (n,).

        Args:
            q: Joint positions [rad]. Shape (n,). Where the arm was not held it is `compensation`.
        """
        held = self._held_at
        near = held is not None and np.abs(q - held).max() < FADE_RANGE
        return self._past[0] if near else self.compensation

    def excess(self) -> str:
        """Joints whose unexplained torque no friction explains, as text; empty without any."""
        rows = zip(self._names, self.torque.tolist(), self._explained.tolist(), strict=True)
        return ", ".join(
            f"{name}: {torque:.1f} N m unexplained (friction explains {explained:.1f})"
            for name, torque, explained in rows
            if abs(torque) > explained
        )
