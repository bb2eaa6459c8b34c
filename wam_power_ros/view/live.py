# SPDX-License-Identifier: Apache-2.0
"""ROS node of the page: newest states, policy and diagnostics of a running session; its services.

The node publishes no commands for an arm. It takes only the newest joint state at each update, so
that it costs the 500 Hz path no more than a best-effort reader.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry, Path
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from wam_power_interfaces.msg import Policy as PolicyMessage
from wam_power_ros.client.feedback import SERVICES, Feedback, answered
from wam_power_ros.client.link import DISCOVERY, Link
from wam_power_ros.client.robot import Robot
from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.policy import Policy
from wam_power_ros.params.resources import robot_description
from wam_power_ros.ros import interface, pose_messages
from wam_power_ros.ros.joint_messages import JointStateReader
from wam_power_ros.ros.outcomes import Answer

APPEAR_TIMEOUT = 2.0  # [s of wall time] for the service of a button


@dataclass
class LiveState:
    """Newest message of each kind, None before the first."""

    q: np.ndarray | None = None  # [rad] (n,)
    receipt_time: float = -np.inf  # of the newest joint state [s, steady clock]
    body: tuple[np.ndarray, np.ndarray] | None = None  # position [m] and quaternion wxyz
    policy: Policy | None = None
    tool_path: np.ndarray | None = None  # in the last finished rollout [m] (T, 3)
    diagnostics: dict[str, tuple[str, str]] = field(default_factory=dict)  # node: level, summary


class View(Node):
    """Subscribes to the topics of a session and calls its services, through its link."""

    def __init__(self, controller: Mapping[str, Any], body: str) -> None:
        super().__init__("view")
        self.state = LiveState()
        # Text of the arm's URDF, "" until it is received
        self.urdf = robot_description(controller["urdf"]) if controller["urdf"] else ""
        self._reader = JointStateReader(controller["joint_names"])
        self.model_joint_names = tuple(controller["model_joint_names"])
        self.base_frame = controller["base_frame"]  # link in whose frame the body is
        self.link = link = Link(self, APPEAR_TIMEOUT)
        self._feedback = Feedback(link)
        self._robot = Robot(link, controller["state_topic"], body=body)
        self._scene, _ = self._robot.scene_reset, self._robot.demonstrator  # early: discovery
        self._newest = [(link.poll_latest(JointState, controller["state_topic"]), self._on_joints)]
        if body:
            states = link.poll_latest(Odometry, interface.body_topic(body, "state"))
            self._newest.append((states, self._on_body))
        read = lambda it: policies.from_json(it.text)  # noqa: E731
        self._policy = link.last(PolicyMessage, interface.POLICY, read)
        self._path = link.last(Path, interface.ROLLOUT_END_EFFECTOR, pose_messages.path)
        if not self.urdf:
            link.last(String, interface.ROBOT_DESCRIPTION, self._on_urdf)
        qos = interface.STATE_OUT
        link.listen(DiagnosticArray, interface.DIAGNOSTICS, self._on_diagnostics, qos)
        taught = (interface.GRAVITY_COMPENSATION, True), (interface.RECORD, True)
        self._offered = {**dict(SERVICES.values()), **dict(taught)}
        for name, data in self._offered.items():
            link.prepare(name, data=data)

    def update(self) -> LiveState:
        """Take the newest messages received since the last update."""
        for take, then in self._newest:
            if (message := take()) is not None:
                self.link.read(then, message)
        path = self._path()
        self.state.policy = self._policy()
        self.state.tool_path = None if path is None else path.position
        for name in self._offered:
            self.link.offers(name)  # so that a button need not wait for the discovery
        return self.state

    # Called from the threads of the buttons

    def give(self, kind: str, value: float | None = None) -> Answer:
        """Give feedback, see `Feedback.give`; the answer says why if it could not be given."""
        return answered(lambda: self._feedback.give(kind, value=value))

    def teach(self, wait_for_end: Callable[[], object], notify: Callable[[str], object]) -> Answer:
        """Add a demonstration to the session, see `Feedback.teach`.

        `wait_for_end` returns when the person has finished; a stand-in needs no such call.
        """

        def teach() -> Answer:
            simulated = self.link.until(lambda: self._scene.offered, timeout=2.0 * DISCOVERY)
            return self._feedback.teach(self._robot, None if simulated else wait_for_end, notify)

        return answered(teach)

    # Subscriptions

    def _on_joints(self, message: JointState) -> None:
        reading = self._reader(message)
        if reading is not None:
            self.state.q, self.state.receipt_time = reading.q, time.monotonic()

    def _on_body(self, message: Odometry) -> None:
        state = pose_messages.odometry(message)
        self.state.body = (state.position, np.roll(state.quat_xyzw, 1))

    def _on_urdf(self, message: String) -> None:
        self.urdf = message.data

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        levels = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warning"}
        for status in message.status:
            namespace, _, node = status.name.partition(":")[0].rpartition("/")
            if namespace == self.get_namespace().strip("/"):  # not those of another arm
                said = {node: (levels.get(status.level, "error"), status.message)}
                # The page iterates over the last one in its own thread.
                self.state.diagnostics = {**self.state.diagnostics, **said}
