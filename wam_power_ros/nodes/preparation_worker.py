# SPDX-License-Identifier: Apache-2.0
"""Process beside the torque controller: takes its requests, answers, publishes and logs.

Started by `preparation.Preparation`, with plain scheduling and its own node; ends with the
controller. It hands requests over with what they are about: policies with their tables, and
movements sampled on the control grid.
"""

from __future__ import annotations

import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from wam_power_ros.control import policy_execution, replay_trajectory
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError
from wam_power_ros.control.safety import Limits
from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.nodes.preparation import (
    MOVEMENT,
    NAME,
    REQUEST,
    channel_of_process,
    settings_of,
)
from wam_power_ros.ros import interface, joint_messages, node_runner, pose_messages, requests
from wam_power_ros.ros.answers import NOT_ACTIVE, Answer, Code
from wam_power_ros.ros.diagnostics import diagnostics_message
from wam_power_ros.ros.process_channel import Channel, Message
from wam_power_ros.ros.stamps import time_message

# Larger messages are refused unread: 20 MB are 200 000 points of seven joints with positions alone,
# where the 600 s that may be replayed have 60 000 points.
SIZE_MAX = {REQUEST: requests.SIZE_MAX + 64, MOVEMENT: 20_000_000}
POINTS_MAX = 200_000
TEXT_MAX = 2000  # characters of a refusal
POLICY_REQUESTS = ("move_to_start", "execute")


class PreparationWorker(Node):
    """Node of the process.

    Attributes:
        ended: True once the torque controller has ended or closed its end of the channel.

    Args:
        channel: Connection to the torque controller.
    """

    def __init__(self, channel: Channel) -> None:
        super().__init__(NAME)
        self.ended = False
        self._channel = channel
        self._inbox: deque[Message | None] = deque()
        self._configuration = 0  # number of the last `configure`
        self._settings: ControllerSettings | None = None
        self._joint_names: tuple[str, ...] = ()
        self._asked = ("", "")  # id and policy of the last request about one
        # Arrays of the last two of each kind: when the loop releases one, its memory is freed here.
        self._shared: dict[str, deque[object]] = {what: deque(maxlen=2) for what in SIZE_MAX}
        self._paths = self.create_publisher(Path, interface.ROLLOUT_END_EFFECTOR, interface.LATCHED)
        self._policies = self.create_publisher(String, interface.POLICY, interface.LATCHED)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, interface.DIAGNOSTICS, interface.DIAGNOSTICS_QOS
        )
        self._answers = requests.Answers(self, interface.CONTROLLER_ANSWER)
        self._take(String, interface.CONTROLLER_REQUEST, REQUEST, self._request)
        self._take(JointTrajectory, interface.REPLAY, MOVEMENT, self._movement)
        # Not Executor.wake(), after which the executor waits again without calling anything.
        self._arrived = self.create_guard_condition(self._handle_messages)
        threading.Thread(target=self._listen, daemon=True).start()

    # From the torque controller

    def _listen(self) -> None:
        """Receive into `_inbox`, because the executor can wait only for the middleware."""
        with suppress(rclpy_implementation.InvalidHandle):  # the node has ended first
            try:
                while True:
                    self._inbox.append(self._channel.receive())
                    self._arrived.trigger()
            except EOFError:
                self._inbox.append(None)
                self._arrived.trigger()

    def _handle_messages(self) -> None:
        """Handle all messages from the torque controller."""
        while self._inbox:
            message = self._inbox.popleft()
            if message is None:
                self.ended = True
                return
            getattr(self, f"_do_{message.values['what']}")(*message)

    def _do_configure(self, values: dict[str, Any], _: object) -> None:
        self._configuration = values["number"]
        settings = values["settings"]
        self._settings = None if settings is None else settings_of(settings)
        self._joint_names = tuple(values["joint_names"])

    def _do_answer(self, values: dict[str, Any], _: object) -> None:
        id, policy = self._asked
        if values["id"] == id and values["code"] == Code.BEGUN.value:
            self._policies.publish(String(data=policy))
        self._answers.give(
            values["id"], Answer(Code(values["code"]), values["text"], values["values"])
        )

    def _do_path(self, values: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        path = EndEffectorPath(values["id"], **arrays)
        message = pose_messages.path_message(path, values["start_ns"], values["frame"])
        self._paths.publish(message)

    def _do_report(self, values: dict[str, Any], _: object) -> None:
        if any(later is not None and later.values["what"] == "report" for later in self._inbox):
            return  # reports that waited for the start of this process are out of date
        parts = (values[key] for key in ("name", "hardware_id", "level", "text", "values"))
        self._diagnostics.publish(diagnostics_message(time_message(values["stamp_ns"]), *parts))

    def _do_log(self, values: dict[str, Any], _: object) -> None:
        log = self.get_logger()  # rclpy requires a separate line of code for each severity
        if values["severity"] == "error":
            log.error(values["text"])
        elif values["severity"] == "warning":
            log.warning(values["text"])
        else:
            log.info(values["text"])

    # From the network

    def _take(self, kind: type, topic: str, what: str, take: Callable[[bytes, int], None]) -> None:
        """Subscribe to messages of a kind; a message that cannot be taken is refused."""

        def received(data: bytes, info: dict[str, int]) -> None:
            try:
                if (size := len(data)) > SIZE_MAX[what]:
                    raise ValueError(f"{size} bytes; at most {SIZE_MAX[what]} allowed")
                take(data, info["source_timestamp"])
            except Exception as error:  # of any kind: the process goes on
                self._refuse(what, error)

        self.create_subscription(kind, topic, received, interface.REQUESTS, raw=True)

    def _refuse(self, what: str, error: Exception) -> str:
        """Report a refusal; returns its text."""
        text = str(error) if isinstance(error, (ValueError, ControllerError)) else repr(error)
        self._channel.send({"what": "refused", "kind": what, "text": text[:TEXT_MAX]})
        return text[:TEXT_MAX]

    def _prepare(self, id: str, what: str, prepare: Callable[[], None]) -> None:
        """Prepare what a request is about and hand it over, or answer why it is refused."""
        if not self._answers.is_new(id):
            return
        if self._settings is None:
            return self._answers.give(id, NOT_ACTIVE)
        self._channel.send({"what": "reading", "id": id})
        try:
            prepare()
        except ControllerError as error:
            text = self._refuse(what, error)
            self._answers.give(id, Answer(Code(error.refusal.value), text, error.values))
        except Exception as error:  # of any kind: the process goes on
            self._answers.give(id, Answer(Code.REFUSED, self._refuse(what, error)))
        return None

    def _request(self, data: bytes, sent_ns: int) -> None:
        asked = requests.request(deserialize_message(data, String).data)
        self._prepare(asked.id, REQUEST, lambda: self._prepare_policy(asked, sent_ns))

    def _prepare_policy(self, asked: requests.Request, sent_ns: int) -> None:
        if asked.do not in POLICY_REQUESTS or asked.about.keys() - {"stop"} != {"policy"}:
            given = ", ".join([asked.do, *asked.about])
            raise ValueError(f"{POLICY_REQUESTS} of a policy can be requested, not {given}")
        settings, limits = self._arm()
        policy = policies.from_json(asked.about["policy"])
        prepared = vars(policy_execution.prepare(policy, limits, settings))
        arrays = {name: each for name, each in prepared.items() if isinstance(each, np.ndarray)}
        rest = {name: each for name, each in prepared.items() if name not in arrays}
        self._asked = asked.id, asked.about["policy"]
        sent = sent_ns, asked.about.get("stop")
        values = {"what": "policy", "id": asked.id, "do": asked.do, "sent": sent, "policy": rest}
        self._hand_over(REQUEST, values, arrays)

    def _movement(self, data: bytes, sent_ns: int) -> None:
        message = deserialize_message(data, JointTrajectory)
        id, knows, stop = requests.checked_id(message.header.frame_id).partition(" ")
        sent = sent_ns, stop if knows else None
        self._prepare(id, MOVEMENT, lambda: self._prepare_movement(id, message, sent))

    def _prepare_movement(
        self, id: str, message: JointTrajectory, sent: tuple[int, str | None]
    ) -> None:
        settings, limits = self._arm()
        if (points := len(message.points)) > POINTS_MAX:
            raise ValueError(f"{points} points; at most {POINTS_MAX} allowed")
        movement = joint_messages.movement(message, self._joint_names)
        sampled = replay_trajectory.sampled(movement, 1.0, settings.period, limits)
        values = {"duration": sampled.duration, "period": sampled.period}
        arrays = {"q": sampled.q, "qd": sampled.qd, "qdd": sampled.qdd}
        about = {"what": "movement", "id": id, "movement": values, "sent": sent}
        self._hand_over(MOVEMENT, about, arrays)

    def _arm(self) -> tuple[ControllerSettings, Limits]:
        """Settings and limits of the arm."""
        return self._settings, self._settings.limits

    def _hand_over(self, what: str, values: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        shared = self._channel.send({**values, "configuration": self._configuration}, arrays)
        self._shared[what].append(shared)


def main() -> int:
    """Run until the torque controller has ended; SIGINT and SIGTERM are blocked in this process."""
    channel = channel_of_process()
    with node_runner.participant(lambda: PreparationWorker(channel)) as node:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not node.ended:
            executor.spin_once(timeout_sec=1.0)
    return 0


if __name__ == "__main__":
    sys.exit(main())
