# SPDX-License-Identifier: Apache-2.0
"""The arm while its states stay away, or since a fault has been found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Motion, Speeds
from wam_power_ros.control.estimate import Estimate
from wam_power_ros.control.plausibility import Plausibility
from wam_power_ros.control.state_checks import JointState

REST_NS = 200_000_000  # [ns] of rest after which a fault may be reset

Acting = Callable[[np.ndarray], np.ndarray]  # posture (n,) [rad] -> torque of the motors [N m]


class DoubtedArm:
    """Where the arm is taken to be, and since when it rests.

    Args:
        plausibility: Checks that know of the states before.
    """

    def __init__(self, plausibility: Plausibility) -> None:
        self._plausibility = plausibility
        self._estimate: Estimate | None = None
        self._rest_ns: int | None = None  # stamp since which the arm rests

    def trust(self) -> None:
        """The next state is believed as it is."""
        self._estimate = None

    def faulted(self) -> None:
        """A fault has been found: the arm does not rest."""
        self._rest_ns = None

    def without_state(self, last: JointState, acting: Acting, dt: float) -> JointState:
        """The arm's state after a time [s] without one, since the last of all or since this call.

        Args:
            last: Last state that came.
            acting: Torque that the motors have been sent, by posture.
            dt: Time [s].
        """
        arm = self._estimate = self._estimate or self._plausibility.estimate(last, lie=0)
        arm.advance(acting(arm.q), dt)
        return last._replace(q=arm.q, qd=arm.qd)

    def after_fault(
        self, state: JointState, motion: Motion | Speeds, acting: Acting, new: bool
    ) -> JointState:
        """The arm's state when one has come that may be false.

        Args:
            state: State that has come.
            motion: Its kinematics.
            acting: Torque that the motors have been sent, by posture.
            new: True for the state in which the fault was found.
        """
        believed = self._plausibility.doubted_ns != state.stamp_ns
        if not isinstance(motion, Motion) or safety.unrest(motion) or not believed:
            self._rest_ns = None
        elif self._rest_ns is None:
            self._rest_ns = state.stamp_ns
        arm = self._estimate = self._estimate or self._plausibility.estimate(state)
        if not new:
            arm.follow(state, acting(arm.q), believed)
        return state._replace(q=arm.q, qd=arm.qd)

    def rested(self, stamp_ns: int) -> bool:
        """Whether the arm has been at rest for `REST_NS`, in states that can be believed."""
        return self._rest_ns is not None and stamp_ns - self._rest_ns >= REST_NS
