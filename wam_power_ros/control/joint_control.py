# SPDX-License-Identifier: Apache-2.0
"""Joint-space control: follow joint references by inverse dynamics with PD feedback.

tau = rnea(q, qd, qdd_ref + w^2 (q_ref - q) + 2 zeta w (qd_ref - qd)) + friction of qd_ref
"""

import numpy as np

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.joint_references import (
    Brake,
    MinJerk,
    ReferenceSequence,
    Sampled,
    Step,
)
from wam_power_ros.control.safety import Limits
from wam_power_ros.control.stationary_joints import StationaryJoints
from wam_power_ros.control.tracking_error import TrackingError, TrackingLost

BANDWIDTH = 25.0  # [rad/s] w; with a delay of 8 ms, 30 is the most that survives a push of 40 N
DAMPING_RATIO = 0.7  # zeta
FRICTION_SHARE = 0.8  # share of the joints' friction that is fed forward while the reference moves
BRAKE_TIME = 0.15  # [s] braking time when a hold begins
TRACKING_ERROR_MAX = 0.3  # [rad] largest error of a joint while moving, replaying or holding
_STIFFNESS, _DAMPING = BANDWIDTH**2, 2.0 * DAMPING_RATIO * BANDWIDTH


class JointControl:
    """Follows one joint reference after another, then brakes and holds.

    Attributes:
        replay_error: Tracking error of the last replay so far; None before the first.

    Args:
        arm: Model of the arm.
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
