# SPDX-License-Identifier: Apache-2.0
"""Process beside the torque controller: prepares policies and movements, publishes and logs.

Started by `preparation.Preparation`, with plain scheduling and its own node; ends with the
controller. It hands over policies with their tables, and movements sampled on the control grid.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from wam_power_ros.control import prepared_policy, replay_trajectory
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError
from wam_power_ros.control.safety import Limits
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.nodes.preparation import (
    MOVEMENT,
    NAME,
    POLICY,
    TABLES,
    channel_of_process,
    settings_of,
)
from wam_power_ros.ros import interface, joint_messages, node_runner, pose_messages
from wam_power_ros.ros.diagnostics import diagnostics_message
from wam_power_ros.ros.process_channel import Channel, Message
from wam_power_ros.ros.stamps import time_message

# Larger messages are refused unread. A policy is as long as its text; 20 MB are 200 000 points of
# seven joints with positions alone, where the 600 s that may be replayed have 60 000 points.
SIZE_MAX = {POLICY: policies.SIZE_MAX + 64, MOVEMENT: 20_000_000}
POINTS_MAX = 200_000
TEXT_MAX = 2000  # characters of a refusal
SETTLE_TIMEOUT = 1.0  # [s] longest wait until the threads of the middleware are idle


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
        self._seen: set[tuple[str, int]] = set()
        self._senders: list[str] = []  # nodes that publish policies, at the last report
        # Arrays of the last two of each kind: when the loop releases one, its memory is freed here.
        self._shared: dict[str, deque[object]] = {what: deque(maxlen=2) for what in SIZE_MAX}
        self._paths = self.create_publisher(Path, interface.ROLLOUT_END_EFFECTOR, interface.LATCHED)
        self._finished = self.create_publisher(
            String, interface.ROLLOUT_FINISHED, interface.LATCHED
        )
        self._diagnostics = self.create_publisher(
            DiagnosticArray, interface.DIAGNOSTICS, interface.DIAGNOSTICS_QOS
        )
        self._callbacks: dict[Subscription, Callable[[bytes, dict[str, int]], None]] = {}
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
        self._seen.update((kind, stamp) for kind, stamp in values["seen"])
        if not self._callbacks:
            self._subscribe(String, interface.POLICY, POLICY, self._policy)
            self._subscribe(JointTrajectory, interface.REPLAY_TRAJECTORY, MOVEMENT, self._movement)

    def _do_mark(self, values: dict[str, Any], _: object) -> None:
        """Answer once all messages that had arrived by now have been read.

        The request came over the channel and may have overtaken messages that a thread of the
        middleware has not taken from its socket yet; such a thread is running.
        """
        deadline = time.monotonic() + SETTLE_TIMEOUT
        while not other_threads_idle() and time.monotonic() < deadline:
            time.sleep(0.001)
        for each, callback in self._callbacks.items():
            while (taken := each.handle.take_message(each.msg_type, each.raw)) is not None:
                callback(*taken)
        self._channel.send(values)

    def _do_path(self, values: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        path = EndEffectorPath(values["id"], **arrays)
        message = pose_messages.path_message(path, values["start_ns"], values["frame"])
        self._paths.publish(message)
        fault = values["fault"] and Fault(FaultKind(values["fault"][0]), values["fault"][1])
        finished = pose_messages.Finished(
            path.id, values["start_ns"], fault, values["digest"], values["stopped_in"]
        )
        self._finished.publish(pose_messages.finished_message(finished))

    def _do_report(self, values: dict[str, Any], _: object) -> None:
        if any(later is not None and later.values["what"] == "report" for later in self._inbox):
            return  # reports that waited for the start of this process are out of date
        senders = self._policy_senders()
        values["values"]["policy publishers"] = ", ".join(senders)
        if len(senders) > 1 and values["level"] == "ok":
            values |= {"level": "warn", "text": f"{values['text']}; {several(senders)}"}
        parts = (values[key] for key in ("name", "hardware_id", "level", "text", "values"))
        self._diagnostics.publish(diagnostics_message(time_message(values["stamp_ns"]), *parts))

    def _policy_senders(self) -> list[str]:
        """Nodes that publish policies; logged when there are several others than before."""
        topic = self.resolve_topic_name(interface.POLICY)
        senders = interface.publishers(self, topic)
        if len(senders) > 1 and senders != self._senders:
            self.get_logger().warning(several(senders))
        self._senders = senders
        return senders

    def _do_log(self, values: dict[str, Any], _: object) -> None:
        log = self.get_logger()  # rclpy requires a separate line of code for each severity
        if values["severity"] == "error":
            log.error(values["text"])
        elif values["severity"] == "warning":
            log.warning(values["text"])
        else:
            log.info(values["text"])

    # From the network

    def _subscribe(
        self, kind: type, topic: str, what: str, prepare: Callable[[bytes], None]
    ) -> None:
        def callback(data: bytes, info: dict[str, int]) -> None:
            self._read(what, data, info["source_timestamp"], prepare)

        subscription = self.create_subscription(kind, topic, callback, interface.LATCHED, raw=True)
        self._callbacks[subscription] = callback

    def _read(self, what: str, data: bytes, stamp: int, prepare: Callable[[bytes], None]) -> None:
        """Prepare a message, or send the reason why it is refused.

        Messages that are received again because this process was restarted are skipped: an older
        one must not replace the one in use.
        """
        if (what, stamp) in self._seen:
            return
        self._seen.add((what, stamp))
        self._channel.send({"what": "reading", "kind": what, "stamp": stamp})
        try:
            if (size := len(data)) > SIZE_MAX[what]:
                raise ValueError(f"{size} bytes; at most {SIZE_MAX[what]} allowed")
            prepare(data)
        except Exception as error:  # of any kind; the loop keeps the last valid message
            text = str(error) if isinstance(error, (ValueError, ControllerError)) else repr(error)
            self._channel.send({"what": "refused", "kind": what, "text": text[:TEXT_MAX]})

    def _policy(self, data: bytes) -> None:
        settings, limits = self._arm()
        text = deserialize_message(data, String).data
        policy = policies.from_json(text)
        prepared = prepared_policy.prepare(policy, len(limits.q_min), limits, settings)
        tables = vars(prepared.tables)
        values = {
            "policy": {
                "id": policy.id,
                "duration": prepared.duration,
                "content": prepared.content,
                "digest": policies.digest(text),
            },
            "tables": {name: value for name, value in tables.items() if name not in TABLES},
        }
        arrays = {name: tables[name] for name in TABLES} | {
            "q_start": prepared.q_start,
            "orientation_reference": prepared.orientation_reference,
        }
        self._hand_over(POLICY, {"what": "policy", **values}, arrays)

    def _movement(self, data: bytes) -> None:
        settings, limits = self._arm()
        message = deserialize_message(data, JointTrajectory)
        if (points := len(message.points)) > POINTS_MAX:
            raise ValueError(f"{points} points; at most {POINTS_MAX} allowed")
        movement = joint_messages.movement(message, self._joint_names)
        try:
            sampled = replay_trajectory.sampled(movement, 1.0, settings.period, limits)
        except ControllerError as error:  # reported when its replay is requested
            values = {"refusal": error.refusal.value, "text": str(error), "values": error.values}
            self._hand_over(MOVEMENT, {"what": "no movement", **values}, {})
            return
        values = {"duration": sampled.duration, "period": sampled.period}
        arrays = {"q": sampled.q, "qd": sampled.qd, "qdd": sampled.qdd}
        self._hand_over(MOVEMENT, {"what": "movement", "movement": values}, arrays)

    def _arm(self) -> tuple[ControllerSettings, Limits]:
        """Settings and limits of the arm; ValueError when the controller is not configured."""
        settings = self._settings
        if settings is None or settings.limits is None:
            raise ValueError("the controller is not configured")
        return settings, settings.limits

    def _hand_over(self, what: str, values: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        shared = self._channel.send({**values, "configuration": self._configuration}, arrays)
        self._shared[what].append(shared)


def several(senders: list[str]) -> str:
    """Warning that several nodes publish policies: the last message is executed."""
    return f"{len(senders)} nodes publish policies ({', '.join(senders)}): the last one counts"


def other_threads_idle() -> bool:
    """Return True if no other thread of this process is running."""
    tasks = FilePath("/proc/self/task")
    mine = threading.get_native_id()
    states = [
        (task / "stat").read_text().rpartition(")")[2].split()[0]
        for task in tasks.iterdir()
        if task.name != str(mine)
    ]
    return all(state != "R" for state in states)


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
