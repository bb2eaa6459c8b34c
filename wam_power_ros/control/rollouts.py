# SPDX-License-Identifier: Apache-2.0
"""The loaded policy and its rollouts."""

import numpy as np

from wam_power_ros.control.arm import Arm, Motion
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError, Refusal
from wam_power_ros.control.policy_execution import Execution
from wam_power_ros.control.prepared_policy import PreparedPolicy
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.learning.rollout import EndEffectorPath


class Rollouts:
    """Holds at most one policy, and at most one rollout of it that is under way.

    Attributes:
        policy: Loaded policy, None before the first.
        start_ns: Stamp of the first state of the last finished or aborted rollout [ns]; None before
            the first and during a rollout.
        stopped_in: Name of the guarded region that ended it, "" if none did.

    Args:
        arm: Model of the arm.
        settings: Settings of the controller.
    """

    def __init__(self, arm: Arm, settings: ControllerSettings) -> None:
        self.policy: PreparedPolicy | None = None
        self.start_ns: int | None = None
        self.stopped_in = ""
        self._arm, self._settings = arm, settings
        self._completed: set[str] = set()  # contents of policies that have run to their end
        self._execution: Execution | None = None
        self._finished: EndEffectorPath | None = None

    @property
    def active_id(self) -> str | None:
        """Id of the policy whose rollout is under way, None without one."""
        return None if self._execution is None else self._execution.id

    @property
    def completed_before(self) -> bool:
        """Whether a rollout of the loaded policy has run to its end before."""
        return self.policy is not None and self.policy.content in self._completed

    def loaded(self, request: str) -> PreparedPolicy:
        """Return the loaded policy.

        Args:
            request: Name of the request that needs it, for the error message.

        Raises:
            ControllerError: No policy is loaded.
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
        policy, tolerance = self.loaded("rollout"), self._settings.start_tolerance
        error = np.abs(q - policy.q_start)
        worst = int(np.argmax(error))
        if error[worst] > tolerance:
            joint = f"{self._arm.joint_names[worst]} is {error[worst]:.3f} rad from the start"
            text = f"rollout refused: {joint} of policy {policy.id}, tolerance {tolerance:g}"
            raise ControllerError(Refusal.NOT_AT_START, text, {"policy": policy.id})

    def begin(self) -> None:
        """Begin a rollout of the loaded policy with the next state; drop the last path."""
        self._finished = self.start_ns = None
        self._execution = Execution(self.loaded("rollout"), self._arm, self._settings)

    def torque(self, state: JointState, motion: Motion) -> np.ndarray | None:
        """Joint torques for one state, None when the rollout is over [N m]. Shape (n,).

        Raises:
            TrackingLost: The tool's orientation is too far from its reference.
        """
        execution = self._execution
        if execution is None:
            raise RuntimeError("no rollout is under way")
        tau = execution.torque(state.stamp_ns, state.q, state.qd, motion)
        if tau is None and execution.complete and self.policy is not None:
            self._completed.add(self.policy.content)
        return tau

    def end(self, last: JointState | None) -> None:
        """Keep the path of the rollout under way, complete or not; no effect without one.

        Args:
            last: Last joint state, None before the first.
        """
        execution, self._execution = self._execution, None
        if execution is not None and last is not None:
            self._finished = execution.path(last.q, last.qd)
            self.start_ns, self.stopped_in = execution.start_ns, execution.stopped_in

    def take_path(self) -> EndEffectorPath | None:
        """Return the path of the last finished or aborted rollout, once; then None."""
        path, self._finished = self._finished, None
        return path
