# SPDX-License-Identifier: Apache-2.0
"""Services of Barrett's own driver that a controller calls: gravity compensation and idle."""

from __future__ import annotations

import numpy as np
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from hardware_sim.settings import ArmSimParams
from hardware_sim.world import World
from wam_power_ros.ros import interface
from wam_power_ros.ros.outcomes import Answer, Code, fill


class BarrettServices:
    """Barrett's services on a simulated world.

    Attributes:
        deactivated: True if only zero torques reach the arm, until gravity compensation is
            requested, as with a ros2_control controller after a command of the wrong size.
    """

    def __init__(self, node: Node, world: World, params: ArmSimParams) -> None:
        self.deactivated = False
        self._world, self._params = world, params
        serve = node.create_service
        serve(SetBool, interface.WAM_GRAVITY_COMPENSATE, self._on_gravity_compensate)
        serve(Trigger, interface.WAM_IDLE, self._on_idle)

    def torque(self, tau: np.ndarray | None) -> np.ndarray | None:
        """Command (n,) that takes effect where `tau` is commanded; None for no command."""
        if self.deactivated:
            return np.zeros(self._world.n) if self._params.output == "torque" else None
        return tau

    def _on_gravity_compensate(
        self, request: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
        """On: torque commands reach the arm. Off: the arm is idle."""
        self.deactivated = False
        self._world.idle = not request.data
        return fill(response, Answer(Code.DONE))

    def _on_idle(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._world.idle = True
        return fill(response, Answer(Code.DONE))
