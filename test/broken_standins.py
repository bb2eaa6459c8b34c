# SPDX-License-Identifier: Apache-2.0
"""The stand-ins with one fault, which is named on the topic /fault and can change as they run."""

from __future__ import annotations

import sys
from array import array

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from hardware_sim import arm_node, main, optitrack_node
from hardware_sim.sensors import MocapFrame
from wam_power_ros import rotations
from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.tracking.tracker import Y_UP

SILENT = "silent"  # no more states, which a check notices as soon as it waits for one
FAULTS = (
    "none",
    "wrong order",
    "no velocity",
    "100 Hz",
    "two publishers",
    "frozen",
    "Y-up",
    "another frame",
    "no watchdog",
    SILENT,
)
Z_UP = Y_UP.T  # from z up to y up


class _Fault:
    """The active fault, shared by both nodes of the process."""

    name = "none"


class BrokenArm(arm_node.ArmSim):
    """A driver whose names, velocities, rate or watchdog are wrong."""

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
        """Publish one state with the fault, if the rate allows."""
        self._count += 1
        if _Fault.name == SILENT or (_Fault.name == "100 Hz" and self._count % 5):
            return
        names = list(self.params.joint_names)
        message.name = names[::-1] if _Fault.name == "wrong order" else names
        if _Fault.name == "no velocity":
            message.velocity = array("d")
        super().publish(message)
        if _Fault.name == "two publishers" and self._count % 50 == 0:
            self._second.publish(message)

    def tick(self, reading: joint_messages.TorqueReading | None) -> JointState:
        """Step once; without a watchdog the last torque is held for ever."""
        self._held = reading or self._held
        return super().tick(self._held if _Fault.name == "no watchdog" else reading)


class BrokenOptitrack(optitrack_node.OptitrackSim):
    """A motion capture that repeats its last pose, has y up, or measures in another frame."""

    def __init__(self) -> None:
        super().__init__()
        self._seen: MocapFrame | None = None
        self._frame = self.params.frame

    def publish(self, frame: MocapFrame, stamp_offset_ns: int, now_ns: int) -> None:
        """Publish one frame with the fault."""
        frame_id = "camera" if _Fault.name == "another frame" else self._frame
        self.params = self.params.model_copy(update={"frame": frame_id})
        if _Fault.name == "frozen" and self._seen is not None:
            frame = self._seen._replace(stamp_ns=frame.stamp_ns)
        elif _Fault.name == "Y-up":
            quat_xyzw = rotations.multiply(rotations.quat_xyzw(Z_UP), frame.quat_xyzw)
            markers = None if frame.markers is None else np.asarray(frame.markers) @ Z_UP.T
            frame = frame._replace(
                position=Z_UP @ frame.position, quat_xyzw=quat_xyzw, markers=markers
            )
        else:
            self._seen = frame
        super().publish(frame, stamp_offset_ns, now_ns)


if __name__ == "__main__":
    main.ArmSim, main.OptitrackSim = BrokenArm, BrokenOptitrack
    sys.exit(main.main())
