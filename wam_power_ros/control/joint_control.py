# SPDX-License-Identifier: Apache-2.0
"""Joint-space control: follow joint references by inverse dynamics with PD feedback.

tau = rnea(q, qd, qdd_ref + w^2 (q_ref - q) + 2 zeta w (qd_ref - qd)) + friction of qd_ref
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.joint_references import Brake, MinJerk, ReferenceSequence, Sampled, Step
from wam_power_ros.control.safety import Limits
from wam_power_ros.faults import FaultKind

BANDWIDTH = 25.0  # [rad/s] w; with a delay of 8 ms, 30 is the most that survives a push of 40 N
DAMPING_RATIO = 0.7  # zeta
FRICTION_SHARE = 0.8  # share of the joints' friction that is fed forward while the reference moves
BRAKE_TIME = 0.15  # [s] braking time when a hold begins
TRACKING_ERROR_MAX = 0.3  # [rad] largest error of a joint while moving, replaying or holding
_STIFFNESS, _DAMPING = BANDWIDTH**2, 2.0 * DAMPING_RATIO * BANDWIDTH
TOOL_STRIDE = 5  # states from one comparison of tool positions to the next
REFERENCE_MOTION = 5e-4  # [rad] of the reference since the joint stands still: 5 encoder counts
FREE_SPEED_MAX = 0.2  # [rad/s] largest speed that the feedback may give the joint if it is free
HOLDABLE_FRICTION = 2.0  # multiple of its nominal friction that may hold a joint
HOLDABLE_SHARE = 0.04  # share of its torque limit added to that: a pan 20 % lighter or heavier
MOTION_TIMEOUT = 10  # states within which a joint must move under more torque than may hold it


class TrackingLost(RuntimeError):
    """The arm is too far from its reference to follow it."""

    kind = FaultKind.TRACKING


class JointStands(TrackingLost):
    """A joint does not move although friction cannot hold it: it is blocked, or its state false."""

    kind = FaultKind.STANDSTILL


class TrackingError:
    """Running statistics of the error between reference and measured posture.

    Attributes:
        largest: Largest error of each joint so far [rad]. Shape (n,).
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self.count = 0
        self.largest = np.zeros(arm.n)
        self._squares = np.zeros(arm.n)
        # Tool positions are compared during the movement: at its end it would take too long.
        self._tool_count = 0
        self._tool_squares, self._tool_largest = 0.0, 0.0

    def add(self, q_ref: np.ndarray, q: np.ndarray) -> None:
        """Add one state: reference and measured posture [rad]. Shapes (n,)."""
        error = q_ref - q
        self._squares += error * error
        np.maximum(self.largest, np.abs(error), out=self.largest)
        if self.count % TOOL_STRIDE == 0:
            tool_error = self._arm.tool_pose(q_ref)[0] - self._arm.tool_pose(q)[0]
            distance = math.hypot(*tool_error.tolist())
            self._tool_count += 1
            self._tool_squares += distance * distance
            self._tool_largest = max(self._tool_largest, distance)
        self.count += 1

    @property
    def rms(self) -> np.ndarray:
        """Root mean square error of each joint so far [rad]. Shape (n,)."""
        return np.sqrt(self._squares / max(self.count, 1))

    def tool(self) -> tuple[float, float]:
        """Root mean square and largest distance of the tool from its reference [m]."""
        return math.sqrt(self._tool_squares / max(self._tool_count, 1)), self._tool_largest

    def text(self, joint_names: Sequence[str]) -> str:
        """Summary in a few lines."""
        rms, (tool_rms, tool_largest) = self.rms, self.tool()
        lines = [
            f"rms error {rms.max():.4f} rad in the worst joint, {joint_names[int(rms.argmax())]}",
            f"tool: rms {tool_rms * 1e3:.1f} mm, at most {tool_largest * 1e3:.1f} mm",
        ]
        lines += [
            f"{name}: rms {joint_rms:.4f} rad, at most {largest:.4f} rad"
            for name, joint_rms, largest in zip(joint_names, rms, self.largest, strict=True)
        ]
        return "\n".join(lines)


class StationaryJoints:
    """Bounds the feedback torque at joints that stand still while their reference moves.

    Such a joint reports the same position, bit for bit. Either friction holds it, or its reported
    position is frozen while the arm moves. The torque tells the two apart: friction holds a joint
    against at most twice its nominal friction.

    Feedback that friction may hold acts in full only until a free joint would have reached
    `FREE_SPEED_MAX`, then with opposite sign until a free joint would be at rest again, then not at
    all. Feedback above that always acts, and the joint must move.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._holdable = (HOLDABLE_FRICTION * arm.friction + HOLDABLE_SHARE * arm.tau_max).tolist()
        self._friction = arm.friction.tolist()
        self.begin()

    def begin(self) -> None:
        """Restart: no joint counts as stationary."""
        n = self._arm.n
        self._q: list[float] = [float("nan")] * n  # reported position [rad]
        self._q_ref = [0.0] * n  # reference when the joint first reported this position [rad]
        self._free_speed = [0.0] * n  # speed that a free joint would have [rad/s]
        self._reached = [False] * n  # whether this speed has reached its maximum
        self._overdue = [0] * n  # states under more torque than friction can hold

    def joints(self, q: np.ndarray, q_ref: np.ndarray) -> list[int]:
        """Stationary joints whose reference moves, at a new state: q, q_ref (n,) [rad]."""
        found = []
        for i, (position, reference) in enumerate(zip(q.tolist(), q_ref.tolist(), strict=True)):
            if position != self._q[i]:
                self._q[i], self._q_ref[i] = position, reference
                self._free_speed[i], self._reached[i], self._overdue[i] = 0.0, False, 0
            elif abs(reference - self._q_ref[i]) > REFERENCE_MOTION:
                found.append(i)
        return found

    def bounded(
        self, joints: list[int], feedback: np.ndarray, inertia: np.ndarray, dt: float
    ) -> np.ndarray:
        """Bound the feedback torque at stationary joints [N m]. Shape (n,).

        Args:
            feedback: Torque in addition to gravity and the reference's acceleration [N m].
            inertia: Inertia of every joint with the others locked [kg m^2]. Shape (n,).
            dt: Time since the last state [s].

        Raises:
            JointStands: A joint does not move although friction cannot hold it.
        """
        bounded = feedback.copy()
        for i in joints:
            size, friction = abs(feedback[i]), self._friction[i]
            if size > self._holdable[i]:
                self._overdue[i] += 1
                if self._overdue[i] > MOTION_TIMEOUT:
                    text = f"joint {i + 1} does not move under a feedback torque of"
                    raise JointStands(f"{text} {feedback[i]:.1f} N m")
                continue
            self._overdue[i] = 0
            speed = self._free_speed[i]
            if not self._reached[i]:
                self._free_speed[i] = max(speed + (size - friction) / inertia[i] * dt, 0.0)
                self._reached[i] = self._free_speed[i] >= FREE_SPEED_MAX
                continue
            bounded[i] = -feedback[i] if speed > 0.0 else 0.0
            self._free_speed[i] = max(speed - (size + friction) / inertia[i] * dt, 0.0)
        return bounded


class JointControl:
    """Follows one joint reference after another, then brakes and holds.

    Attributes:
        replay_error: Tracking error of the last replay so far; None before the first.

    Args:
        limits: Limits of the arm; braking never ends beyond its joint limits.
    """

    def __init__(self, arm: Arm, limits: Limits) -> None:
        self._arm = arm
        self._references = ReferenceSequence(
            lambda q, qd: Brake(q, qd, BRAKE_TIME, limits.q_min, limits.q_max)
        )
        self._last: tuple[np.ndarray, np.ndarray] | None = None  # q_ref, qd_ref of the last state
        self._stamp_ns = 0  # of the last state
        self._stationary = StationaryJoints(arm)
        self.replay_error: TrackingError | None = None

    @property
    def holding(self) -> bool:
        """Whether all references have been followed to their end."""
        return self._references.ended

    def begin(self, *steps: Step) -> None:
        """Follow these references from the next state on, then hold."""
        self._references.begin(*steps)

    def move(self, goal: np.ndarray, speed: float, *then: Sampled) -> None:
        """Move to a posture [rad] with a peak joint speed [rad/s], then replay these movements."""
        self.begin(lambda q: MinJerk(q, goal, speed), *then)
        if then:
            self.replay_error = TrackingError(self._arm)

    def release(self) -> None:
        """Drop the reference: the next one begins at the measured state."""
        self._last = None
        self._stationary.begin()

    def torque(self, stamp_ns: int, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Joint torques [N m] for one state; inverse dynamics decouples the joints. Shapes (n,).

        Raises:
            TrackingLost: A joint is too far from its reference.
        """
        last = self._last or (q, qd)  # continue from the last reference, else from the state
        q_ref, qd_ref, qdd_ref = self._references.at(stamp_ns, *last)
        self._last = q_ref, qd_ref
        holding = self._references.ended
        # Plain floats: NumPy costs more than the arithmetic, above all when the caches are cold.
        speed_ref = qd_ref.tolist()
        error = [a - b for a, b in zip(q_ref.tolist(), q.tolist(), strict=True)]
        at_end = not any(speed_ref)  # while braking the arm may lag behind
        worst = max(map(abs, error))
        # An arm that was moved away while holding (idled by its board, say) must not spring back.
        if worst > TRACKING_ERROR_MAX and (not holding or at_end):
            raise TrackingLost(
                f"a joint is {worst:.3f} rad from its reference, limit {TRACKING_ERROR_MAX}"
            )
        if self.replay_error is not None and isinstance(self._references.reference, Sampled):
            self.replay_error.add(q_ref, q)
        rows = zip(qdd_ref.tolist(), error, speed_ref, qd.tolist(), strict=True)
        qdd = np.array([a + _STIFFNESS * e + _DAMPING * (v - w) for a, e, v, w in rows])
        arm = self._arm
        tau = arm.inverse_dynamics(q, qd, qdd)
        if not holding:
            # From the speed of the reference: the measured one would make it chatter.
            tau += FRICTION_SHARE * arm.friction_torque(qd_ref)
        dt, self._stamp_ns = (stamp_ns - self._stamp_ns) * 1e-9, stamp_ns
        if not (joints := self._stationary.joints(q, q_ref)):
            return tau
        feedforward = arm.inverse_dynamics(q, qd, qdd_ref)
        inertia = arm.mass_matrix(q).diagonal()
        feedback = self._stationary.bounded(joints, tau - feedforward, inertia, dt)
        return feedforward + feedback
