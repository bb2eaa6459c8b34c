# SPDX-License-Identifier: Apache-2.0
"""Model of the arm and its controller, to simulate policies before they are sent."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.feasibility import simulate, simulate_policy, speed_margin
from wam_power_ros.faults import Fault
from wam_power_ros.learning.policy import Policy, to_json, with_id
from wam_power_ros.learning.rollout import SimulatedRollout
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import robot_description, share
from wam_power_ros.params.torque_controller_params import TorqueControllerParams

# Parameters of a controller on which no rollout depends: devices, names, the machine.
ELSEWHERE = {"autostart", "simulation", "realtime_priority", "hardware_id", "state_topic"}
ELSEWHERE |= {"velocity_topic", "command_topic", "command_type", "effort", "allow_no_realtime"}
ELSEWHERE |= {"idle_service", "urdf", "base_frame", "state_timeout", "hold_to_run", "move_speed"}


class SimulatedArm:
    """Simulates policies for the practice (`practice.ArmModel`); keeps the results.

    `parameters` are those of the controller that it simulates, by name.
    """

    def __init__(
        self,
        urdf: str,
        joint_names: Sequence[str],
        tool_frame: str,
        controller: Sequence[str],
        report: Callable[[str], object],
    ) -> None:
        """Read the arm, from a path or a file of our share folder, and its controller's parameters.

        Later files of the controller are over earlier ones; a ValueError if a value is not valid.
        """
        urdf = robot_description(urdf)
        setup = overlay.from_files([share(file) for file in controller])
        params = TorqueControllerParams.from_setup(setup)
        own = TorqueControllerParams.model_fields.keys() - ELSEWHERE
        self.parameters = {name: setup["torque_controller"][name] for name in sorted(own)}
        parts = params.corrections, params.base_frame, params.position_limits
        self.kinematics = Arm(urdf, joint_names, tool_frame, (), *parts)
        self.identity = self.kinematics.identity()
        self._controller, self.region = params.controller(urdf), params.region
        self._report = report
        # movement and unpredicted limit stops -> fault that ends it, None if it is feasible
        self._verdicts: dict[tuple[str, int], Fault | None] = {}

    def infeasible(self, policy: Policy, limit_stops: int = 0) -> Fault | None:
        """See `practice.ArmModel`."""
        key = to_json(with_id(policy, "movement")), limit_stops
        if key not in self._verdicts:
            arm, settings = self._controller.arm, self._controller.settings
            simulated = simulate_policy(arm, settings, policy, speed_margin(limit_stops))
            self._report(f"{policy.id} simulated: {simulated}")
            self._verdicts[key] = simulated.fault
        return self._verdicts[key]

    def simulate(self, policy: Policy) -> SimulatedRollout | None:
        """See `practice.ArmModel`."""
        return simulate(self._controller.arm, self._controller.settings, policy)
