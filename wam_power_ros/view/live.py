# SPDX-License-Identifier: Apache-2.0
"""A running session, seen over ROS: newest states, policy and diagnostics; and its services.

The node publishes nothing an arm obeys. It takes one joint state per look, the newest, so that it
costs the 500 Hz path no more than a best-effort reader does.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
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

CALLBACKS = 8  # at most, of one look
ANSWER_TIMEOUT = 10.0  # [s of wall time]
NEWEST = QoSProfile(depth=1, reliability=interface.STATE_IN.reliability)


@dataclass
class Seen:
    """Newest message of each kind.

    Attributes:
        q: Joint angles [rad], None before the first state. Shape (n,).
        heard: Time of receipt of the newest joint state [s, steady clock].
        body: Position [m] and quaternion wxyz of the tracked body, None before the first.
        policy: Policy that was published last, None before the first.
        tool_path: Path of the tool in the last finished rollout [m]. Shape (T, 3).
        diagnoses: Node -> level and summary of its last diagnostics.
    """

    q: np.ndarray | None = None
    heard: float = -np.inf
    body: tuple[np.ndarray, np.ndarray] | None = None
    policy: Policy | None = None
    tool_path: np.ndarray | None = None
    diagnoses: dict[str, tuple[str, str]] | None = None


class View(Node):
    """Listens to a session and calls its services.

    Attributes:
        seen: Newest message of each kind.

    Args:
        arm: Parameters of the controller.
        body: Name of the tracked body, empty for none.
        namespace: Namespace of the nodes of the session.
    """

    def __init__(self, arm: Mapping[str, Any], body: str, namespace: str = "") -> None:
        super().__init__("view", namespace=namespace)
        self.seen = Seen(diagnoses={})
        self._body = body
        self._urdf = share(arm["urdf"]).read_text() if arm["urdf"] else ""
        self._reader = JointStateReader(arm["joint_names"])
        self.model_joint_names = tuple(arm["model_joint_names"])
        subscribe = self.create_subscription
        subscribe(JointState, arm["state_topic"], self._on_joints, NEWEST)
        subscribe(String, interface.POLICY, self._on_policy, interface.LATCHED)
        subscribe(Path, interface.ROLLOUT_END_EFFECTOR, self._on_path, interface.LATCHED)
        subscribe(
            DiagnosticArray, interface.DIAGNOSTICS, self._on_diagnosis, interface.DIAGNOSTICS_QOS
        )
        if body:
            subscribe(Odometry, interface.body_topic(body, "state"), self._on_body, NEWEST)
        if not self._urdf:
            subscribe(String, interface.ROBOT_DESCRIPTION, self._on_urdf, interface.LATCHED)
        self._bags = self.create_publisher(String, interface.LEARNER_BAG, interface.LATCHED)
        names = ("REWARD", "PUNISH", "DEMONSTRATION")
        triggers = [getattr(interface, f"LEARNER_{name}") for name in names]
        self.reset = interface.body_topic(body, "reset")
        triggers += [interface.STOP, interface.DEMONSTRATE, self.reset]
        switches = (interface.LEARNER_PAUSE, interface.GRAVITY_COMPENSATION, interface.RECORD)
        self._asked = {name: self.create_client(Trigger, name) for name in triggers}
        self._asked |= {name: self.create_client(SetBool, name) for name in switches}
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self)

    @property
    def urdf(self) -> str:
        """Text of the arm's URDF, empty until it is known."""
        return self._urdf

    def look(self) -> Seen:
        """Take what has come since the last look, of a state only the newest."""
        for _ in range(CALLBACKS):
            self._executor.spin_once(timeout_sec=0.0)
        return self.seen

    # From the threads of the buttons

    def offered(self, name: str) -> bool:
        """Whether a service is offered now."""
        return bool(self._asked[name].service_is_ready())

    def ask(self, name: str, on: bool | None = None) -> Answer:
        """Call a service and wait for its answer, while another thread looks.

        Args:
            name: Name of the service.
            on: Data of a SetBool; None for a Trigger.
        """
        request = Trigger.Request() if on is None else SetBool.Request(data=on)
        done = threading.Event()
        try:
            if not self.offered(name):
                return Answer(Code.NOT_ACTIVE, f"nobody offers {name} now")
            future = self._asked[name].call_async(request)
            future.add_done_callback(lambda _: done.set())
        except rclpy_implementation.InvalidHandle:
            return Answer(Code.NOT_ACTIVE, "the session has ended")
        if not done.wait(ANSWER_TIMEOUT):
            return Answer(Code.UNKNOWN, f"{name} did not answer in {ANSWER_TIMEOUT:.0f} s")
        response = future.result()
        return answers.read(response.success, response.message)

    def name_bag(self, bag: FilePath) -> None:
        """Tell the learner which bag the next demonstration is in."""
        self._bags.publish(String(data=str(bag)))

    # Messages in

    def _on_joints(self, message: JointState) -> None:
        reading = self._read(lambda: self._reader(message))
        if reading is not None:
            self.seen.q, self.seen.heard = reading.q, time.monotonic()

    def _on_body(self, message: Odometry) -> None:
        state = self._read(lambda: pose_messages.odometry(message))
        if state is not None:
            self.seen.body = (state.position, np.roll(state.quat_xyzw, 1))

    def _on_policy(self, message: String) -> None:
        self.seen.policy = self._read(lambda: policies.from_json(message.data)) or self.seen.policy

    def _on_path(self, message: Path) -> None:
        path = self._read(lambda: pose_messages.path(message))
        if path is not None:
            self.seen.tool_path = path.position

    def _on_urdf(self, message: String) -> None:
        self._urdf = message.data

    def _on_diagnosis(self, message: DiagnosticArray) -> None:
        for status in message.status:
            level = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warning"}
            above, _, named = status.name.partition(":")[0].rpartition("/")
            if above == self.get_namespace().strip("/"):  # not those of another arm
                said = (level.get(status.level, "error"), status.message)
                self.seen.diagnoses = {**self.seen.diagnoses, named: said}

    def _read(self, convert: Callable[[], Any]) -> Any:  # noqa: ANN401 - whatever it converts to
        try:
            return convert()
        except ValueError as error:
            self.get_logger().warning(f"message ignored: {error}", throttle_duration_sec=5.0)
            return None
