# SPDX-License-Identifier: Apache-2.0
"""Reaction to a fault: what brakes and holds the arm, whatever its states say.

There are two witnesses of the arm's motion: the reported positions, and the model, integrated with
the torques that were sent since a time before the fault. The brake acts in full on the speed that
both confirm. What the states alone say is answered by a torque that, in `ANSWER_TIME`, gives the
tool of an arm that in truth rests no more than `REACTION_SPEED`; within that time `Supervision`
asks again whether they are believed. States that are not believed change no torque, but that they
may confirm a speed of the model. Once the arm rests, the answer is counted from the torque that
holds it; a torque that an arm is known to need at rest, or that creeps while nothing seems to move,
stays constant, whatever is reported, until the arm falls.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.state_checks import JointState, PastState, at_rate
from wam_power_ros.learning.policy import PERIOD

# Numbers of states are those at 500 Hz: at a higher rate they are more, see `at_rate`.
TORQUE_DELAY = 2  # states until a torque acts: 4 ms, of the 2 to 8 ms of drivers and motors
RATE_STATES = 4  # states over which a reported speed is measured
STRIDE_COUNT = 25  # steps in which the model is integrated up to a fault
BEFORE, BEFORE_GUIDED = 0.2, 0.4  # [s] before a fault at which states were true
BEFORE_STEP, BEFORE_SILENCE = 0.05, 0.02  # [s] the same before a contradiction, before a silence
EFFECT_TIME = 0.02  # [s] after which the reaction shows in the states, with all delays of a loop
FRICTION_ITERATIONS = 3  # fixed-point iterations of the implicit friction
CREEP_SPEED = 0.005  # [rad/s] speed below which friction holds a joint
BRAKE_TIME = 0.3  # [s] until an arm that is braked rests: e^-6 of its speed
KNOWN_FRICTION, KNOWN_SHARE = 2.0, 0.02  # a torque so close to the known one carries nothing else
SETTLED_SPEED = 0.1  # [rad/s] of the model, below which it rests once it has braked
REACTION_SPEED = 0.1  # [m/s] that the answer to unconfirmed states may give a resting arm's tool
ANSWER_TIME = 0.03  # [s] within which states that are false are no longer believed
GROWTH = 1.5  # of the reported energy in that time, in spite of the brake
HOLD_FREQUENCY = 20.0  # [rad/s] of the hold, with a damping of 20 1/s: half of the critical one
STILL = 0.002  # [rad] change of the reported positions within STILL_TIME, below which it rests
STILL_SPEED = 0.05  # [rad/s] above which a brake that gives all it may must slow the arm
STILL_TIME = 0.15  # [s]
CALM_TIME = 0.05  # [s] the same of an arm that was held when the fault was found
SLIP_MIN, SLIP_MAX = 0.03, 1.0  # [rad/s] speed of a joint that follows the drift of its zero
SLIP_CHANGE = 0.1  # of friction: change of a torque that shows such a speed
SLIP_EXCESS = 1.25  # of its friction, which also stops the joint before gravity has grown
SLIP_UNSTEADY = 0.2  # of this change, by which that of its first half may differ from a half
SLIP_SHARE, SLIP_FRICTION = 0.005, 0.25  # of a torque limit, of friction: by which others differ
FALL_SPEED = 0.4  # [rad/s] growth of a reported speed after which a held arm is taken to fall

MotorTorque = Callable[[np.ndarray], np.ndarray]  # posture (n,) [rad] -> motor torque (n,) [N m]


class ModelState:
    """State of the arm by its model alone.

    Attributes:
        q: Joint positions [rad]. Shape (n,).
        qd: Joint speeds [rad/s]. Shape (n,).

    Args:
        q: Positions to begin with [rad]. Shape (n,).
        qd: Speeds to begin with [rad/s]. Shape (n,).
        external: Constant torque beyond the model [N m]. Shape (n,).
        acting: Motor torques commanded that do not act yet [N m], oldest first. Shapes (n,).
        period: Sampling period of the states [s].
    """

    def __init__(
        self,
        arm: Arm,
        q: np.ndarray,
        qd: np.ndarray,
        external: np.ndarray,
        acting: list[np.ndarray],
        period: float,
    ) -> None:
        self._arm, self.q, self.qd, self.external = arm, q, qd, external
        self._acting = deque(acting, maxlen=at_rate(TORQUE_DELAY, period) + 1)

    def advance(self, tau: np.ndarray, dt: float) -> None:
        """Integrate over a time [s] with a commanded motor torque (n,) [N m]; it acts later."""
        self._acting.append(tau)
        self.predict(self._acting[0], dt)

    def predict(self, tau: np.ndarray, dt: float) -> None:
        """Integrate over a time [s] in which a torque (n,) [N m] acts; friction only brakes."""
        arm, qd = self._arm, self.qd
        mass = arm.mass_matrix(self.q)
        driving = tau + self.external - arm.bias(self.q, qd) - arm.damping * qd
        momentum = mass.dot(qd) + dt * driving
        # Implicit: friction of the light wrist joints also acts on the joints coupled to them.
        for _ in range(FRICTION_ITERATIONS):
            held = dt * arm.friction / np.maximum(np.abs(qd), CREEP_SPEED)
            qd = np.linalg.solve(mass + np.diag(held), momentum)
        qd[np.abs(qd) < 1e-6] = 0.0  # so that it comes to rest bit for bit
        self.qd = np.minimum(np.maximum(qd, -arm.qd_max), arm.qd_max)
        self.q = self.q + dt * self.qd


def confirmed(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Speeds that two witnesses confirm: the slower one, zero where they contradict. Shape (n,)."""
    slower = np.minimum(np.abs(first), np.abs(second))
    return np.where(first * second > 0.0, np.copysign(slower, first), 0.0)


class Reaction:
    """Brakes the arm in a fault and while states are missing, then holds it.

    Attributes:
        unanswered: True once the energy of the reported motion has grown by half within
            `ANSWER_TIME` although the torque brakes it, so that the states are false.
        carried: Torque beyond g(q) that carried the arm before the fault [N m]. Shape (n,).
        known: Torque [N m] within which friction and model explain a difference. Shape (n,).
        alone: True while the model alone tells the motion, and no reported speed corrects it.
        was_held: True if the fault was found in a hold, so that `carried` has held the arm at rest.
    """

    def __init__(self, arm: Arm, motor_torque: MotorTorque, period: float = PERIOD) -> None:
        self._arm, self._motor_torque, self._period = arm, motor_torque, period
        self.known = KNOWN_FRICTION * arm.friction + KNOWN_SHARE * arm.tau_max
        self.carried = np.zeros(arm.n)
        self._rates = at_rate(RATE_STATES, period)
        self.past: deque[PastState] = deque(maxlen=round(BEFORE_GUIDED / period))
        self._recent: deque[np.ndarray] = deque(maxlen=round(STILL_TIME / period))  # [rad]
        self._model: ModelState | None = None
        self._external: np.ndarray  # torque beyond the model before the fault [N m]
        self._reference: tuple[np.ndarray, np.ndarray] | None  # that comes to rest: q, qd
        self._asked: tuple[float, float] | None  # energy, and time since then [s]
        self._weight: np.ndarray | None  # of a mass at the tool, once recognized [N m]
        # Torque that last held the resting arm, and its share that the states alone ask for [N m].
        self._held: tuple[np.ndarray, np.ndarray] | None
        self._resting = np.zeros(arm.n)  # torque that rests it, or carries it where the model is
        self._model_error: np.ndarray | None  # torque that carries the arm beyond g(q) [N m]
        self._anchor: np.ndarray | None  # torque when the arm came to rest [N m]
        self._frozen: np.ndarray | None  # torque that rests the arm whatever is reported [N m]
        self._kept: np.ndarray | None  # torque beyond g that an arm needed before it fell [N m]
        self._seconds: float  # since the brake began
        self.end()

    def forget(self) -> None:
        """Forget the past: the next state has no predecessor."""
        self.past.clear()

    def record(self, state: JointState, tau: np.ndarray, external: list[float]) -> None:
        """Keep a state, the motor torque (n,) and the external one (n numbers) before it [N m]."""
        self.past.append(PastState(state.q, tau, external, state.span))

    @property
    def posture(self) -> np.ndarray:
        """Posture of the arm by its model, while it brakes or holds the arm [rad]. Shape (n,)."""
        return np.zeros(self._arm.n) if self._model is None else self._model.q

    @property
    def settled(self) -> bool:
        """Whether the arm rests by its model, which then does not change any more."""
        model = self._model
        if model is None or np.abs(model.qd).max() > SETTLED_SPEED:
            return False
        return not self.alone or self._seconds > BRAKE_TIME

    @property
    def frozen(self) -> bool:
        """Whether the torque rests the arm, whatever its states report."""
        return self._frozen is not None

    @property
    def rested(self) -> bool:
        """Whether the arm has reported rest since the fault."""
        return self._held is not None or self._kept is not None

    def end(self) -> None:
        """Use the measured states again, and forget what was held."""
        self._model = self._reference = self._asked = self._frozen = self._anchor = None
        self._weight = self._held = self._kept = self._model_error = None
        self._external = np.zeros(self._arm.n)
        self._believed = self.alone = True
        self.unanswered = self._slow = self.was_held = False
        self._seconds = self._calm = 0.0
        self._recent.clear()

    def begin(
        self, before: float, alone: bool = False, guided: bool = False, held: bool = False
    ) -> None:
        """Begin at the state a time [s] ago, unless the model is followed already.

        Args:
            before: Time before now at which the model begins, because states were true then [s].
            alone: Whether the model alone tells what came of it: the states since then contradict
                themselves, or the arm moved by itself, under torques that are known. Else the model
                only confirms what they report.
            guided: Whether a person moved the arm, who may let go now.
            held: True if the arm was in a hold, in which the torque `carried` held it.
        """
        if self._model is None:
            self.end()
            self.was_held = held
            self._model, self.alone = self._before(before), alone
            if self._model is None and held and self.past:  # held for less than RATE_STATES
                self._model = self._at_posture(self.past[-1].q)
                self._model.external = self._external = -self.carried
            if not alone and self._model is not None:
                self._model.q = self.past[-1].q
                self._model.qd = confirmed(self._model.qd, self.reported())
            speeds = self.reported() if self._model is None else self._model.qd
            self._slow = bool(np.abs(speeds).max() < SETTLED_SPEED)
        if guided:
            self._external = np.zeros(self._arm.n)
            if self._model is not None:
                self._model.external = self._external

    def distrust(self) -> None:
        """Let the model alone tell what an arm did since it was held, if it was not long ago."""
        known = BEFORE + self._seconds < BEFORE_GUIDED and self._weight is None
        if self.was_held and self._slow and known and not self.alone:
            self._model, self.alone = self._before(BEFORE + self._seconds) or self._model, True

    def followed(self) -> tuple[int, float] | None:
        """Joint that follows the drift of its zero, and torque that would rest it [N m], or None.

        It reports rest, and the torque that keeps it there changes steadily, as gravity does when
        one joint moves; friction may hide a change from the others.
        """
        arm, rows = self._arm, list(self.past)
        at = np.array([each.q for each in rows]).reshape(len(rows), arm.n)
        moved = np.flatnonzero((np.abs(at - at[-1:]) > 3.0 * STILL).any(axis=1))
        rows = rows[moved[-1] + 1 if len(moved) else 0 :]
        if len(rows) < round(STILL_TIME / self._period):
            return None
        third = len(rows) // 3
        taus = np.array([each.tau for each in rows[-3 * third :]]).reshape(3, third, arm.n)
        first, middle, last = taus.mean(axis=1)
        change, seconds = last - first, sum(each.dt for each in rows[-2 * third :])
        steady = np.abs(middle - first - 0.5 * change) < SLIP_UNSTEADY * np.abs(change)
        slope = arm.gravity_slope(rows[-1].q)
        allowed = SLIP_SHARE * arm.tau_max + SLIP_FRICTION * arm.friction
        for joint in np.flatnonzero(steady & (np.abs(change) > SLIP_CHANGE * arm.friction)):
            way = change[joint] / (slope[joint, joint] or math.inf)
            due = slope[:, joint] * way
            left = change - np.clip(change, np.minimum(due, 0.0), np.maximum(due, 0.0))
            if SLIP_MIN < abs(way) / seconds < SLIP_MAX and (np.abs(left) <= allowed).all():
                friction = math.copysign(SLIP_EXCESS * arm.friction[joint], way)
                return int(joint), float(last[joint] + 0.25 * change[joint] - friction)
        return None

    def assume_speeds(self, qd: np.ndarray) -> None:
        """Brake an arm that moves at speeds (n,) [rad/s] which its states do not report."""
        if self._model is not None:
            self._model.qd = qd

    def _before(self, seconds: float) -> ModelState | None:
        """State by the model that began a time [s] ago; None if that is not known."""
        past = list(self.past)[-max(round(seconds / self._period), self._rates + 1) :]
        return self._integrated(past) if len(past) > self._rates else None

    def _integrated(self, past: list[PastState]) -> ModelState:
        first = past[0]
        seconds = sum(each.dt for each in past[1 : self._rates + 1])
        qd = (past[self._rates].q - first.q) / seconds
        delay = at_rate(TORQUE_DELAY, self._period)
        taus = [first.tau] * delay + [each.tau for each in past]
        rested = self.was_held and np.abs(qd).max() < SETTLED_SPEED
        self._external = external = -self.carried if rested else np.array(first.external)
        model = ModelState(self._arm, first.q, qd, external, taus[len(past) :], self._period)
        stride = max(1, math.ceil(len(past) / STRIDE_COUNT))
        for k in range(1, len(past), stride):
            rows = past[k : k + stride]
            tau = np.mean(taus[k : k + len(rows)], axis=0)
            model.predict(tau, sum(each.dt for each in rows))
        return model

    def missing(self, last: JointState, believed: bool, dt: float) -> JointState:
        """State of the arm while none is received, by the model.

        Args:
            last: Last state received.
            dt: Time since this state or since the last call [s].
        """
        if self._model is None:
            model = self._before(BEFORE_SILENCE if believed else BEFORE)
            if model is None:
                model = self._at_posture(last.q)
                model.qd = last.qd
            if believed:
                model.q = last.q
            self._model = model
        self._reference = None
        self._recent.clear()
        if not self.settled:
            self._model.advance(self._motor_torque(self._model.q), dt)
        self._seconds += dt
        return last.moved(self._model.q, self._model.qd)

    def without_state(self, state: JointState) -> np.ndarray:
        """Motor torque of a fault [N m] in a state of the model, shape (n,); see `torque`."""
        if self._frozen is not None:
            return self._frozen
        error = self.carried if self._model_error is None else self._model_error
        resting = self._arm.gravity(state.q) + error if self._held is None else self._held[0]
        return resting - safety.FAULT_DAMPING * self._arm.mass_matrix(state.q).dot(state.qd)

    def _at_posture(self, q: np.ndarray) -> ModelState:
        self._external = zero = np.zeros(self._arm.n)
        return ModelState(self._arm, q, zero, zero, [], self._period)

    def follow(self, q: np.ndarray, model_error: np.ndarray) -> None:
        """Carry an arm that truly falls where it is reported, by a torque beyond g(q).

        Args:
            q: Reported joint positions [rad]. Shape (n,).
            model_error: Torque that would carry it, as its fall shows [N m]. Shape (n,).
        """
        model = self._model = self._model or self._at_posture(q)
        self._kept, self._frozen, self._anchor = model_error, None, None
        self._seconds, self.alone = 0.0, False  # it is braked anew
        model.q, model.qd, self._held, self._believed = q, self.reported(), None, True

    def reported(self) -> np.ndarray:
        """Speeds by the reported positions [rad/s], (n,); the model's in the 8 ms after a gap."""
        past = list(self.past)[-self._rates - 1 :]
        if len(past) <= self._rates:  # a driver that paused may stamp an old state as new
            return np.zeros(self._arm.n) if self._model is None else self._model.qd
        return (past[-1].q - past[0].q) / sum(each.dt for each in past[1:])

    def torque(
        self, state: JointState, believed: bool, explained: bool, weight: np.ndarray | None
    ) -> np.ndarray:
        """Motor torque that brakes and holds the arm [N m]. Shape (n,).

        Args:
            explained: True if it is believed, and the torques sent explain the motion it reports.
            weight: Torque of a weight at the tool that the model does not have [N m]. Shape (n,).
        """
        model = self._model = self._model or self._at_posture(state.q)
        reported = self.reported()
        self._advance(model, believed, explained, reported, state.span)
        model.external = self._external if weight is None else weight
        if weight is not None or self._held is None:
            self._weight = weight
        if self._frozen is not None:
            self._resting = self._frozen
            return self._frozen
        mass, gravity = self._arm.mass_matrix(model.q), self._arm.gravity(model.q)
        model_error = self.carried if self._weight is None else -self._weight
        self._model_error = model_error if self._kept is None else self._kept
        carrying = gravity + self._model_error
        resting = self._resting = carrying if self._held is None else self._held[0]
        if believed and not self._believed and self.settled:
            self._frozen = resting
        self._believed = believed
        if self._frozen is not None:
            return self._frozen
        if believed:
            return self._answer(state, reported, mass, gravity, carrying)
        self._reference, self.unanswered = None, False
        self._recent.clear()
        qd = model.qd if self.alone else confirmed(model.qd, reported)
        return resting - safety.FAULT_DAMPING * mass.dot(qd)

    def _answer(
        self,
        state: JointState,
        reported: np.ndarray,
        mass: np.ndarray,
        gravity: np.ndarray,
        carrying: np.ndarray,
    ) -> np.ndarray:
        """Motor torque (n,) [N m] in a state that is believed.

        The speeds (n,) [rad/s] are by positions; M, g and the torque that carries the arm at the
        model's posture.
        """
        model, damping = self._model or self._at_posture(state.q), safety.FAULT_DAMPING
        qd = confirmed(model.qd, reported)
        braking = mass.dot(qd)
        if braking.dot(reported) < 0.0 or braking.dot(model.qd) < 0.0:
            qd, braking = 0.0 * qd, 0.0 * braking  # coupled joints: it would drive one of the two
        alone = self._arm.gravity(state.q) - gravity
        q_ref, qd_ref = self._reference or (state.q, reported)
        self._reference = q_ref + state.span * qd_ref, math.exp(-damping * state.span) * qd_ref
        spring = HOLD_FREQUENCY**2 * mass.dot(q_ref - state.q)
        alone = alone + spring - damping * mass.dot(reported - qd)
        base, usual = self._held or (carrying, 0.0 * alone)
        change = alone - usual
        bounded = self._bounded(change, mass, model.q)
        if np.abs(reported).max() < STILL_SPEED or self._seconds < EFFECT_TIME:
            self._asked = None  # at rest, or torques from before the fault still act
        else:
            if bounded is not change:
                self._reference = state.q, reported  # it never pulls back what it could not stop
            asked = self._weight is None and self._held is None and bounded.dot(reported) < 0.0
            self._ask(bool(asked), float(reported.dot(mass.dot(reported))), state.span)
        tau = base - damping * braking + bounded
        known = self._slow and self._kept is None and self._weight is None
        known = known and bool((np.abs(tau - carrying) <= self.known).all())
        calm = known and self.was_held and np.abs(reported).max() < STILL_SPEED
        self._calm = self._calm + state.span if calm else 0.0
        if self._calm > CALM_TIME:  # what held it holds it, and a drift is not followed
            half = 0.5 * self._arm.friction
            frozen = carrying - np.minimum(np.maximum(tau - carrying, -half), half)
            self._held, self._frozen = (frozen, usual + bounded), frozen
        self._recent.append(state.q)
        full = len(self._recent) == self._recent.maxlen
        if full and np.ptp(self._recent, axis=0).max() < STILL:  # none that swings through
            self._held = tau, usual + bounded
            self._freeze(tau, known, usual + bounded)
        return tau

    def _freeze(self, tau: np.ndarray, known: bool, share: np.ndarray) -> None:
        """Keep a torque that rests the arm if it is known, or if it changes although it rests."""
        if self._anchor is None:
            self._anchor = tau
        change = tau - self._anchor
        if not known and (np.abs(change) <= self.known).all():
            return
        drag, friction = share if known else change, self._arm.friction
        # Where it was enough to move the arm: without half of the friction of this motion.
        moved = np.abs(drag) > friction
        self._frozen = tau - np.where(moved, np.copysign(0.5 * friction, drag), 0.0)
        if (found := self.followed()) is not None:
            self._frozen[found[0]] = found[1]

    def _advance(
        self, model: ModelState, believed: bool, explained: bool, reported: np.ndarray, dt: float
    ) -> None:
        """Let the model brake for a time [s]; states that are believed correct its speeds."""
        before, self._seconds = model.qd, self._seconds + dt
        if not self.settled:
            model.advance(self._motor_torque(model.q), dt)
        if not self.alone or self._seconds > BRAKE_TIME:
            model.qd = confirmed(model.qd, before)  # a brake starts no motion
        if not self.alone or (explained and self._seconds > ANSWER_TIME):
            model.qd = confirmed(model.qd, reported)  # explained so long, they are true
        elif believed:
            slower = confirmed(model.qd, before)  # no error of the model moves it against them
            model.qd = np.where(model.qd * reported < 0.0, slower, model.qd)
        late = np.abs(model.qd).max() < SETTLED_SPEED or self._seconds > 2.0 * BRAKE_TIME
        if self._seconds > BRAKE_TIME and late:
            model.qd = np.zeros(self._arm.n)  # an error of the model would let it creep

    def _ask(self, brakes: bool, energy: float, dt: float) -> None:
        """Notice that states move ever faster against the brake for ANSWER_TIME."""
        if not brakes:
            self._asked = None
            return
        begun, seconds = self._asked or (energy, 0.0)
        self._asked = begun, seconds + dt
        if seconds + dt > ANSWER_TIME:
            self.unanswered = energy > GROWTH * begun
            self._asked = None

    def _bounded(self, tau: np.ndarray, mass: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Bound the torque that only the states ask for, see the module. [N m], shape (n,)."""
        arm = self._arm
        held = np.minimum(np.maximum(tau, -arm.friction), arm.friction)  # moves no resting joint
        driving = tau - held
        if not driving.any():
            return tau
        twist = arm.jacobian(q).dot(np.linalg.solve(mass, driving)) * ANSWER_TIME
        speed = max(float(np.linalg.norm(twist[:3])), 0.25 * float(np.linalg.norm(twist[3:])))
        return tau if speed <= REACTION_SPEED else held + driving * (REACTION_SPEED / speed)
