# SPDX-License-Identifier: Apache-2.0
"""An arm played by a test, state by state, with the torque controller that answers it."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from conftest import ROOT, Probe, Process, Processes, diagnosis
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from wam_power_ros.control.arm import Arm
from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.ros.guards import STAND_IN
from wam_power_ros.ros.stamps import time_message

MODULE = "wam_power_ros.nodes.torque_controller"
SIMULATED = ("torque_controller.yaml", "simulation.yaml")
NAMES = [f"wam_j{i}" for i in range(1, 8)]
HOME = np.deg2rad([0.0, 20.0, 0.0, 115.0, 0.0, -45.0, 0.0])
TICK = 2_000_000  # [ns]
GRAVITY = Arm((ROOT / "urdf/wam7.urdf").read_text(), NAMES).gravity(HOME)  # [N m]


class PlayedArm:
    """An arm that never moves: publishes states and collects torques."""

    def __init__(
        self,
        probe: Probe,
        processes: Processes,
        process: Process | None = None,
        **parameters: object,
    ) -> None:
        self.probe = probe
        quick = {"realtime_priority": 0, "state_timeout": 0.0}
        self.process = process or processes.node(MODULE, *SIMULATED, **(quick | parameters))
        self.torques: list[joint_messages.TorqueReading] = []
        self.messages = probe.listen(
            Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND
        )
        self.diagnostics = probe.diagnostics()
        self.stamp_ns = TICK
        simulated = parameters.get("use_sim_time", False)
        self.sent_ns, self._real_time = 0, bool(parameters.get("state_timeout")) and not simulated
        self._publisher = probe.publisher(
            JointState, interface.JOINT_STATES, interface.STATE_OUT, node=STAND_IN
        )

    def send(
        self, names: list[str] = NAMES, q: np.ndarray = HOME, qd: np.ndarray | None = None
    ) -> None:
        """One state, a tick after the last; as long after it as it was sent, in real time."""
        now_ns = time.monotonic_ns()
        self.stamp_ns += now_ns - self.sent_ns if self._real_time and self.sent_ns else TICK
        self.sent_ns = now_ns
        self.again(names, q, np.zeros(len(names)) if qd is None else qd)

    def again(self, names: list[str], q: np.ndarray, qd: np.ndarray) -> None:
        """A state with the stamp of the last."""
        message = JointState(name=names, position=list(q), velocity=list(qd))
        message.header.stamp = time_message(self.stamp_ns)
        self._publisher.publish(message)

    def answer(self) -> joint_messages.TorqueReading:
        """The torque that answers the newest state."""
        return self.probe.until(
            lambda: next((t for t in self.read() if t.stamp_ns == self.stamp_ns), None),
            f"torque for stamp {self.stamp_ns}",
        )

    def read(self) -> list[joint_messages.TorqueReading]:
        """All torques so far."""
        while len(self.torques) < len(self.messages):
            self.torques.append(joint_messages.torque(self.messages[len(self.torques)], NAMES))
        return self.torques

    def activate(self) -> None:
        """Repeat states until the controller, which starts itself, holds."""

        def held() -> bool:
            self.send()
            self.probe.spin(0.02)
            return any(torque.label == "hold" for torque in self.read())

        self.probe.until(held, "the controller holds")
        self.settle()  # until the torque that holds the arm is known

    def settle(self) -> None:
        """Let the arm come to rest, for more states than a refused one counts."""
        for _ in range(100):
            self.send()
            self.answer()

    def reset(self) -> None:
        """Reset a fault, once the arm has been at rest for long enough."""

        def agreed() -> bool:
            for _ in range(20):
                self.send()
                self.probe.spin(0.001)
            return self.probe.call(Trigger, interface.RESET).success

        self.probe.until(agreed, "the reset of a fault")

    def diagnosis(self, condition: Callable[[dict[str, str]], bool], what: str) -> dict[str, str]:
        """The diagnostics once `condition` is met."""
        newest = lambda: diagnosis(self.diagnostics, "torque_controller")  # noqa: E731
        self.probe.until(lambda: newest() and condition(newest()), what)
        return newest()
