# SPDX-License-Identifier: Apache-2.0
"""The policy that is loaded, and the rollouts of it."""

import numpy as np

from wam_power_ros.control.arm import Arm, Motion
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError, Refusal
from wam_power_ros.control.policy_execution import Execution
from wam_power_ros.control.prepared_policy import PreparedPolicy
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.learning.rollout import EndEffectorPath


class Rollouts:
    """At most one policy, and at most one rollout of it under way.

    Attributes:
        policy: Policy that is loaded, None before the first.
        start_ns: Stamp of the first state of the last rollout that ended, None before [ns].

    Args:
        arm: Model of the arm.
        settings: Settings of the controller.
    """

    def __init__(self, arm: Arm, settings: ControllerSettings) -> None:
        self.policy: PreparedPolicy | None = None
        self.start_ns: int | None = None
        self._arm, self._settings = arm, settings
        self._tried: set[str] = set()  # contents of policies that have run to their end once
        self._present: Execution | None = None
        self._finished: EndEffectorPath | None = None

    @property
    def present(self) -> str | None:
        """Id of the policy whose rollout is under way, None without one."""
        return None if self._present is None else self._present.id

    @property
    def tried(self) -> bool:
        """Whether a rollout of the loaded policy has run to its end before."""
        return self.policy is not None and self.policy.content in self._tried

    def loaded(self, request: str) -> PreparedPolicy:
        """The policy that is loaded.

        Args:
            request: Name of the request that needs it, for the error.

        Raises:
            ControllerError: None is.
        """
        if self.policy is None:
            raise ControllerError(Refusal.NOTHING, f"{request} refused: no policy is loaded")
        return self.policy

    def require_start(self, q: np.ndarray) -> None:
        """Refuse a rollout that would not begin at the policy's start.

        Args:
            q: Joint positions [rad]. Shape (n,).

        Raises:
            ControllerError: No policy is loaded, or the arm is not at its start.
        """
        policy = self.loaded("rollout")
        error = np.abs(q - policy.q_start)
        worst = int(np.argmax(error))
        if error[worst] > self._settings.start_tolerance:
            off = f"{self._arm.joint_names[worst]} is {error[worst]:.3f} rad from the start"
            text = f"rollout refused: {off} of policy {policy.id}"
            raise ControllerError(Refusal.NOT_AT_START, text, {"policy": policy.id})

    def begin(self) -> None:
        """Begin a rollout of the loaded policy with the next state; forget the last one's path."""
        self._finished = self.start_ns = None
        self._present = Execution(self.loaded("rollout"), self._arm, self._settings)

    def torque(self, state: JointState, motion: Motion) -> np.ndarray | None:
        """Joint torques for one state, None when the rollout is over [N m]. Shape (n,).

        Raises:
            TrackingLost: The tool is turned too far from its reference.
        """
        rollout = self._present
        if rollout is None:
            raise RuntimeError("no rollout is under way")
        tau = rollout.torque(state.stamp_ns, state.q, state.qd, motion)
        if tau is None and rollout.complete and self.policy is not None:
            self._tried.add(self.policy.content)
        return tau

    def end(self, last: JointState | None) -> None:
        """Finish the path of the rollout under way, complete or not; nothing without one.

        Args:
            last: Last joint state, None before the first.
        """
        rollout, self._present = self._present, None
        if rollout is not None and last is not None:
            self._finished = rollout.path(last.q, last.qd)
            self.start_ns = rollout.start_ns

    def take_path(self) -> EndEffectorPath | None:
        """Return the path of the rollout that has ended, once; shorter when it was cut short."""
        path, self._finished = self._finished, None
        return path
