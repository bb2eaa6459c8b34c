# SPDX-License-Identifier: Apache-2.0
"""ROS node of the page: newest states, policy and diagnostics of a running session; its services.

The node publishes no commands for an arm. It takes only the newest joint state at each update, so
that it costs the 500 Hz path no more than a best-effort reader.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry, Path
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.policy import Policy
from wam_power_ros.params.resources import share
from wam_power_ros.ros import answers, interface, pose_messages
from wam_power_ros.ros.answers import Answer, Code
from wam_power_ros.ros.joint_messages import JointStateReader

CALLBACKS_MAX = 8  # per update
ANSWER_TIMEOUT = 10.0  # [s of wall time]
NEWEST = QoSProfile(depth=1, reliability=interface.STATE_IN.reliability)


@dataclass
class LiveState:
    """Newest message of each kind.

    Attributes:
        q: Joint angles [rad], None before the first state. Shape (n,).
        receipt_time: Time of receipt of the newest joint state [s, steady clock].
        body: Position [m] and quaternion wxyz of the tracked body, None before the first state.
        policy: Last published policy, None before the first.
        tool_path: Path of the tool in the last finished rollout [m]. Shape (T, 3).
        diagnostics: Node -> level and summary of its last diagnostics.
    """

    q: np.ndarray | None = None
    receipt_time: float = -np.inf
    body: tuple[np.ndarray, np.ndarray] | None = None
    policy: Policy | None = None
    tool_path: np.ndarray | None = None
    diagnostics: dict[str, tuple[str, str]] = field(default_factory=dict)


class View(Node):
    """Subscribes to the topics of a session and calls its services.

    Attributes:
        state: Newest message of each kind.
        urdf: Text of the arm's URDF, "" until it is received.
        model_joint_names: Names of the joints in the URDF.
        reset: Name of the service that resets the scene.

    Args:
        controller: Parameters of the controller.
        body: Name of the tracked body, "" for none.
        namespace: Namespace of the nodes of the session.
    """

    def __init__(self, controller: Mapping[str, Any], body: str, namespace: str = "") -> None:
        super().__init__("view", namespace=namespace)
        self.state = LiveState()
        self.urdf = share(controller["urdf"]).read_text() if controller["urdf"] else ""
        self._reader = JointStateReader(controller["joint_names"])
        self.model_joint_names = tuple(controller["model_joint_names"])
        subscribe = self.create_subscription
        subscribe(JointState, controller["state_topic"], self._on_joints, NEWEST)
        subscribe(String, interface.POLICY, self._on_policy, interface.LATCHED)
        subscribe(Path, interface.ROLLOUT_END_EFFECTOR, self._on_path, interface.LATCHED)
        subscribe(
            DiagnosticArray, interface.DIAGNOSTICS, self._on_diagnostics, interface.DIAGNOSTICS_QOS
        )
        if body:
            subscribe(Odometry, interface.body_topic(body, "state"), self._on_body, NEWEST)
        if not self.urdf:
            subscribe(String, interface.ROBOT_DESCRIPTION, self._on_urdf, interface.LATCHED)
        self._bags = self.create_publisher(String, interface.LEARNER_BAG, interface.LATCHED)
        self.reset = interface.body_topic(body, "reset")
        triggers = (
            interface.LEARNER_REWARD,
            interface.LEARNER_PUNISH,
            interface.LEARNER_DEMONSTRATION,
            interface.STOP,
            interface.DEMONSTRATE,
            self.reset,
        )
        switches = (interface.LEARNER_PAUSE, interface.GRAVITY_COMPENSATION, interface.RECORD)
        self._service_clients = {name: self.create_client(Trigger, name) for name in triggers}
        self._service_clients |= {name: self.create_client(SetBool, name) for name in switches}
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self)

    def update(self) -> LiveState:
        """Take the messages received since the last update, of states only the newest."""
        for _ in range(CALLBACKS_MAX):
            self._executor.spin_once(timeout_sec=0.0)
        return self.state

    # Called from the threads of the buttons

    def is_offered(self, name: str) -> bool:
        """Whether a service is available now; none is once the session has ended."""
        try:
            return bool(self._service_clients[name].service_is_ready())
        except rclpy_implementation.InvalidHandle:
            return False

    def call(self, name: str, on: bool | None = None) -> Answer:
        """Call a service and wait for its answer, while another thread calls `update`.

        Args:
            name: Name of the service.
            on: Data of a SetBool; None for a Trigger.
        """
        request = Trigger.Request() if on is None else SetBool.Request(data=on)
        done = threading.Event()
        try:
            if not self.is_offered(name):
                return Answer(Code.NOT_ACTIVE, f"{name} is not available now")
            future = self._service_clients[name].call_async(request)
            future.add_done_callback(lambda _: done.set())
        except rclpy_implementation.InvalidHandle:
            return Answer(Code.NOT_ACTIVE, "the session has ended")
        if not done.wait(ANSWER_TIMEOUT):
            return Answer(Code.UNKNOWN, f"{name} did not answer in {ANSWER_TIMEOUT:.0f} s")
        response = future.result()
        return answers.read(response.success, response.message)

    def publish_bag(self, bag: FilePath) -> None:
        """Publish the path of the next demonstration for the learner, unless the session ended."""
        with contextlib.suppress(rclpy_implementation.InvalidHandle):
            self._bags.publish(String(data=str(bag)))

    # Subscriptions

    def _on_joints(self, message: JointState) -> None:
        reading = self._read(lambda: self._reader(message))
        if reading is not None:
            self.state.q, self.state.receipt_time = reading.q, time.monotonic()

    def _on_body(self, message: Odometry) -> None:
        state = self._read(lambda: pose_messages.odometry(message))
        if state is not None:
            self.state.body = (state.position, np.roll(state.quat_xyzw, 1))

    def _on_policy(self, message: String) -> None:
        policy = self._read(lambda: policies.from_json(message.data))
        self.state.policy = policy or self.state.policy

    def _on_path(self, message: Path) -> None:
        path = self._read(lambda: pose_messages.path(message))
        if path is not None:
            self.state.tool_path = path.position

    def _on_urdf(self, message: String) -> None:
        self.urdf = message.data

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        levels = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warning"}
        for status in message.status:
            namespace, _, node = status.name.partition(":")[0].rpartition("/")
            if namespace == self.get_namespace().strip("/"):  # not those of another arm
                self.state.diagnostics[node] = (levels.get(status.level, "error"), status.message)

    def _read(self, convert: Callable[[], Any]) -> Any:  # noqa: ANN401 - whatever it converts to
        try:
            return convert()
        except ValueError as error:
            self.get_logger().warning(f"message ignored: {error}", throttle_duration_sec=5.0)
            return None
