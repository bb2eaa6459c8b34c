# SPDX-License-Identifier: Apache-2.0
"""The stand-ins with one fault, which is named on the topic /fault and can change as they run."""

from __future__ import annotations

import sys

from sensor_msgs.msg import JointState
from std_msgs.msg import String

from hardware_sim import arm_node, main, optitrack_node
from hardware_sim.sensors import MocapFrame
from wam_power_ros.ros import interface, joint_messages


class _Fault:
    """The active fault, shared by both nodes of the process."""

    name = "none"


class BrokenArm(arm_node.ArmSim):
    """A driver whose names or watchdog are wrong, or that is silent."""

    def __init__(self) -> None:
        super().__init__()
        self._count = 0
        self._held: joint_messages.TorqueReading | None = None
        self._second = self.create_publisher(
            JointState, interface.JOINT_STATES, interface.STATE_OUT
        )
        self.create_subscription(String, "/fault", self._on_fault, interface.LATCHED)

    def _on_fault(self, message: String) -> None:
        _Fault.name, self._held = message.data, None

    def publish(self, message: JointState) -> None:
        """Publish one state with the fault; none if it is silence."""
        self._count += 1
        if _Fault.name == "silent":
            return
        names = list(self.params.joint_names)
        message.name = names[::-1] if _Fault.name == "wrong order" else names
        super().publish(message)
        if _Fault.name == "two publishers" and self._count % 50 == 0:
            self._second.publish(message)

    def tick(self, reading: joint_messages.TorqueReading | None) -> JointState:
        """Step once; without a watchdog the last torque is held for ever."""
        self._held = reading or self._held
        return super().tick(self._held if _Fault.name == "no watchdog" else reading)


class BrokenOptitrack(optitrack_node.OptitrackSim):
    """A motion capture that measures in another frame."""

    def publish(self, frame: MocapFrame, stamp_offset_ns: int, now_ns: int) -> None:
        """Publish one frame with the fault."""
        frame_id = "camera" if _Fault.name == "another frame" else "world"
        self.params = self.params.model_copy(update={"frame": frame_id})
        super().publish(frame, stamp_offset_ns, now_ns)


if __name__ == "__main__":
    main.ArmSim, main.OptitrackSim = BrokenArm, BrokenOptitrack
    sys.exit(main.main())
