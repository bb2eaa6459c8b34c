# SPDX-License-Identifier: Apache-2.0
"""The supervision of the arm: whether its states are true, its motion allowed, and where it is.

Where it is must be estimated while states stay away, and when one cannot be believed.
"""

from collections.abc import Callable

import numpy as np

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm, Motion, Speeds
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.estimate import Estimate
from wam_power_ros.control.modes import Mode
from wam_power_ros.control.plausibility import Bound, Plausibility
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.learning.rollout import Fault

INERTIAL_SHARE = 0.3  # of the torque that accelerates the arm: sensors and motors lag
STANDING_SHARE = 0.05  # of a torque limit that may be unexplained at a standing joint in a rollout
REST_NS = 200_000_000  # [ns] of rest after which a fault may be reset

Acting = Callable[[np.ndarray], np.ndarray]  # posture (n,) [rad] -> torque of the motors [N m]


class Supervision:
    """Judges every joint state, and says where the arm is to be taken to be.

    Args:
        arm: Model of the arm.
        limits: Limits of the arm.
        settings: Settings of the controller.
        acting: Torque that the motors have been sent, by posture.
    """

    def __init__(
        self, arm: Arm, limits: safety.Limits, settings: ControllerSettings, acting: Acting
    ) -> None:
        self._acting = acting
        self._motion = safety.MotionCheck(limits, arm.guarded)
        self._plausibility = Plausibility(arm)
        self._estimate: Estimate | None = None
        self._rest_ns: int | None = None  # stamp since which an arm in a fault rests
        touched = settings.contact_share * arm.tau_max
        contact = Bound(touched, touched, INERTIAL_SHARE)
        in_rollout = Bound(settings.unexplained_share * arm.tau_max, STANDING_SHARE * arm.tau_max)
        self._unexplained: dict[Mode, Bound | None] = {
            Mode.GRAVITY_COMPENSATION: None,
            Mode.HOLD: contact,
            Mode.MOVE_TO_START: contact,
            Mode.ROLLOUT: in_rollout,
            Mode.REPLAY: contact,
            Mode.FAULT: in_rollout,
        }

    def begin(self) -> None:
        """Begin anew: the next state has no predecessor."""
        self._plausibility.begin()

    def mode_changed(self) -> None:
        """Other limits apply from the next state on."""
        self._motion.begin()

    def faulted(self) -> None:
        """A fault has been found: the arm does not rest."""
        self._rest_ns = None

    def doubt(self, mode: Mode, before: JointState | None, state: JointState) -> Fault | None:
        """Fault of a state that contradicts what else is known; None for one that does not.

        Args:
            mode: Present mode.
            before: State before, None when it is too long ago to compare with.
            state: Present state.
        """
        if mode is Mode.INACTIVE:
            return None
        acting = self._acting(state.q)
        return self._plausibility.fault(before, state, acting, self._unexplained[mode])

    def exceeded(self, mode: Mode, state: JointState, motion: Motion | Speeds) -> Fault | None:
        """Fault of a motion beyond the limits of the mode, or None."""
        return self._motion.fault(mode, state.q, state.qd, motion)

    def trust(self) -> None:
        """The next state is believed as it is."""
        self._estimate = None

    def without_state(self, last: JointState, dt: float) -> JointState:
        """The arm's state after a time without one, since the last of all or since this call.

        Args:
            last: Last state that came.
            dt: Time [s].
        """
        arm = self._estimate = self._estimate or self._plausibility.estimate(last, lie=0)
        arm.advance(self._acting(arm.q), dt)
        return last._replace(q=arm.q, qd=arm.qd)

    def after_fault(self, state: JointState, motion: Motion | Speeds, new: bool) -> JointState:
        """The arm's state when one has come that may be false.

        Args:
            state: State that has come.
            motion: Its kinematics.
            new: True for the state in which the fault was found.
        """
        believed = self._plausibility.doubted_ns != state.stamp_ns
        if not isinstance(motion, Motion) or safety.unrest(motion) or not believed:
            self._rest_ns = None
        elif self._rest_ns is None:
            self._rest_ns = state.stamp_ns
        arm = self._estimate = self._estimate or self._plausibility.estimate(state)
        if not new:
            arm.follow(state, self._acting(arm.q), believed)
        return state._replace(q=arm.q, qd=arm.qd)

    def rested(self, stamp_ns: int) -> bool:
        """Whether the arm has been at rest for `REST_NS`, in states that can be believed."""
        return self._rest_ns is not None and stamp_ns - self._rest_ns >= REST_NS
