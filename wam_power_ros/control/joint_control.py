# SPDX-License-Identifier: Apache-2.0
"""Joint-space control: follow joint references by inverse dynamics with a spring and a damper.

tau = rnea(q, qd, qdd_ref + w^2 (q_ref - q) + 2 zeta w (qd_ref - qd)) + friction of qd_ref
"""

from collections.abc import Callable

import numpy as np

from wam_power_ros.control.arm import FRICTION_SPEED, Arm
from wam_power_ros.control.joint_references import Brake, Course, JointReference, MinJerk, Sampled
from wam_power_ros.control.safety import Limits
from wam_power_ros.control.standing import StandingJoints
from wam_power_ros.control.tracking_error import TrackingError, TrackingLost

BANDWIDTH = 25.0  # [rad/s] w; with a delay of 8 ms, 30 is the most that survives a push of 40 N
DAMPING_RATIO = 0.7  # zeta
FRICTION_SHARE = 0.8  # of the joints' friction that is fed forward where the reference moves
BRAKE_TIME = 0.15  # [s] in which a motion comes to rest when hold begins
TRACKING_ERROR_MAX = 0.3  # [rad] of a joint while moving, replaying or holding
_STIFFNESS, _DAMPING = BANDWIDTH**2, 2.0 * DAMPING_RATIO * BANDWIDTH


class JointControl:
    """Torques that follow one joint reference after another, and hold at the end.

    Attributes:
        replay_error: Tracking error of the last replay so far; None before the first.

    Args:
        arm: Model of the arm.
        limits: Limits of the arm; no brake ends beyond its joint limits.
    """

    def __init__(self, arm: Arm, limits: Limits) -> None:
        self._arm = arm
        self._course = Course(lambda q, qd: Brake(q, qd, BRAKE_TIME, limits.q_min, limits.q_max))
        self._last: tuple[np.ndarray, np.ndarray] | None = None  # q_ref, qd_ref of the last state
        self._stamp_ns = 0  # of the last state
        self._standing = StandingJoints(arm)
        self.replay_error: TrackingError | None = None

    @property
    def holding(self) -> bool:
        """Whether all references have been followed to their end."""
        return self._course.ended

    def begin(self, *steps: JointReference | Callable[[np.ndarray], JointReference]) -> None:
        """Follow these from the next state on, then hold; see `Course.begin`."""
        self._course.begin(*steps)

    def move(self, goal: np.ndarray, speed: float, *then: Sampled) -> None:
        """Move to a posture [rad] with a peak joint speed [rad/s], then replay what is given."""
        self.begin(lambda q: MinJerk(q, goal, speed), *then)
        if then:
            self.replay_error = TrackingError(self._arm)

    def release(self) -> None:
        """Forget the reference: the next one begins where the arm is."""
        self._last = None
        self._standing.begin()

    def torque(self, stamp_ns: int, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Joint torques (n,) [N m] for one state, shapes (n,); all joints are decoupled.

        Raises:
            TrackingLost: A joint is too far from its reference.
        """
        last = self._last or (q, qd)  # continue from the reference, else from where the arm is
        q_ref, qd_ref, qdd_ref = self._course.at(stamp_ns, *last)
        self._last = q_ref, qd_ref
        holding = self._course.ended
        # Plain floats: NumPy costs more than the arithmetic, above all when the caches are cold.
        speed_ref = qd_ref.tolist()
        error = [a - b for a, b in zip(q_ref.tolist(), q.tolist(), strict=True)]
        at_end = not any(speed_ref)  # a brake may lag behind
        worst = max(map(abs, error))
        # An arm that was carried off while it held (idled by its board, say) must not spring back.
        if worst > TRACKING_ERROR_MAX and (not holding or at_end):
            raise TrackingLost(f"a joint is {worst:.3f} rad away from where it should be")
        if self.replay_error is not None and isinstance(self._course.reference, Sampled):
            self.replay_error.add(q_ref, q)
        rows = zip(qdd_ref.tolist(), error, speed_ref, qd.tolist(), strict=True)
        qdd = np.array([a + _STIFFNESS * e + _DAMPING * (v - w) for a, e, v, w in rows])
        arm = self._arm
        tau = arm.inverse_dynamics(q, qd, qdd)
        if not holding:
            # By the reference's direction, not the measured one: it cannot chatter.
            tau += FRICTION_SHARE * (
                arm.friction * np.tanh(qd_ref / FRICTION_SPEED) + arm.damping * qd_ref
            )
        dt, self._stamp_ns = (stamp_ns - self._stamp_ns) * 1e-9, stamp_ns
        if not (joints := self._standing.suspects(q, q_ref)):
            return tau
        carried = arm.inverse_dynamics(q, qd, qdd_ref)
        inertia = arm.mass_matrix(q).diagonal()
        return carried + self._standing.bounded(joints, tau - carried, inertia, dt)
