# SPDX-License-Identifier: Apache-2.0
"""The stand-ins with one fault of the arm, which the topic /fault names and can change."""

from __future__ import annotations

import sys

from sensor_msgs.msg import JointState
from std_msgs.msg import String

from hardware_sim import arm_node, main
from wam_power_ros.ros import interface


class BrokenArm(arm_node.ArmSim):
    """A driver that has two publishers, or that is silent."""

    def __init__(self) -> None:
        super().__init__()
        self._count, self._fault = 0, "none"
        self._second = self.create_publisher(
            JointState, interface.JOINT_STATES, interface.STATE_OUT
        )
        self.create_subscription(String, "/fault", self._on_fault, interface.LATCHED)

    def _on_fault(self, message: String) -> None:
        self._fault = message.data

    def publish(self, message: JointState) -> None:
        """Publish one state with the fault; none if it is silence."""
        self._count += 1
        if self._fault == "silent":
            return
        super().publish(message)
        if self._fault == "two publishers" and self._count % 50 == 0:
            self._second.publish(message)


if __name__ == "__main__":
    main.ArmSim = BrokenArm
    sys.exit(main.main())
