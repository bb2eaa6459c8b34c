# SPDX-License-Identifier: Apache-2.0
"""Process beside the torque controller: takes its requests, answers, publishes and logs.

Started by `preparation.Preparation`, with plain scheduling and its own node; ends with the
controller. It hands requests over with what they are about: policies with their tables, and
movements sampled on the control grid.
"""

from __future__ import annotations

import faulthandler
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any
from uuid import uuid4

import numpy as np
from control_msgs.action import FollowJointTrajectory
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
from rcl_interfaces.msg import Log
from rclpy.clock import Clock
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from wam_power_interfaces.action import ExecutePolicy, MoveToStart, Replay
from wam_power_interfaces.msg import Policy, RolloutEnd
from wam_power_ros.control import policy_preparation, replay_trajectory
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError
from wam_power_ros.control.safety import Limits
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.nodes.preparation import (
    MOVEMENT,
    NAME,
    REQUEST,
    channel_of_process,
    settings_of,
)
from wam_power_ros.ros import interface, joint_messages, node_runner, pose_messages
from wam_power_ros.ros.action_server import Action, Begin
from wam_power_ros.ros.diagnostics import diagnostics_message
from wam_power_ros.ros.outcomes import NOT_ACTIVE, Answer, Code, Ended
from wam_power_ros.ros.process_channel import Channel, Message
from wam_power_ros.ros.stamps import sent_ns, time_message

# Larger movements are refused unread: 20 MB are 200 000 points of seven joints with positions,
# where the 600 s that may be replayed have 60 000 points.
SIZE_MAX = 20_000_000
POINTS_MAX = 200_000
TEXT_MAX = 2000  # characters of a refusal
STAGE = "moving"  # of a request, once the arm moves
# [s] Fast DDS may wait in its own end for ever, on one core, while another participant leaves.
END_TIMEOUT = 10.0


class PreparationWorker(Node):
    """Node of the process.

    Attributes:
        ended: True once the torque controller has ended or closed its end of the channel.
    """

    def __init__(self, channel: Channel) -> None:
        super().__init__(NAME)
        self.ended = False
        self._channel = channel
        self._inbox: deque[Message | None] = deque()
        self._configuration = 0  # number of the last `configure`
        self._settings: ControllerSettings | None = None
        self._joint_names: tuple[str, ...] = ()
        self._asked: dict[str, Policy] = {}  # policy of a request under way, by id
        # Arrays of the last two of each kind: when the loop releases one, its memory is freed here.
        self._shared: dict[str, deque[object]] = {
            what: deque(maxlen=2) for what in (REQUEST, MOVEMENT)
        }
        self._path = Path()  # of the last rollout
        self._paths = self.create_publisher(Path, interface.ROLLOUT_END_EFFECTOR, interface.LATCHED)
        self._policies = self.create_publisher(Policy, interface.POLICY, interface.LATCHED)
        self._ends = self.create_publisher(RolloutEnd, interface.ROLLOUT_END, interface.LATCHED)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, interface.DIAGNOSTICS, interface.DIAGNOSTICS_QOS
        )
        self._log = self.create_publisher(Log, interface.LOG, interface.LOG_QOS)
        self._actions = [
            Action(self, kind, name, begin, self._cancel, result)
            for kind, name, begin, result in (
                (ExecutePolicy, interface.EXECUTE_POLICY, self._of_policy("execute"), None),
                (MoveToStart, interface.MOVE_TO_START, self._of_policy("move_to_start"), None),
                (Replay, interface.REPLAY_MOVEMENT, self._replay, None),
                (FollowJointTrajectory, interface.FOLLOW_TRAJECTORY, self._follow, followed),
            )
        ]
        topic, qos = interface.REPLAY, interface.REPLAYS
        self.create_subscription(JointTrajectory, topic, self._on_movement, qos, raw=True)
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

    def _do_begun(self, values: dict[str, Any], _: object) -> None:
        id = values["id"]
        if id in self._asked:
            self._policies.publish(self._asked[id])
        for action in self._actions:
            action.report(id, STAGE)

    def _do_ended(self, values: dict[str, Any], _: object) -> None:
        more: dict[str, Any] = {}
        if "end" in values:
            end = values["end"]
            fault = end["fault"] and Fault(FaultKind(end["fault"]["kind"]), end["fault"]["text"])
            message = Ended(**{**end, "fault": fault}).message()
            self._ends.publish(message)
            more = {"end": message, "path": self._path}
        answer = values["answer"]
        self._finish(values["id"], Answer(**{**answer, "code": Code(answer["code"])}), **more)

    def _finish(self, id: str, answer: Answer, **more: Any) -> None:  # noqa: ANN401 - see Action
        self._asked.pop(id, None)
        for action in self._actions:
            if id in action.under_way:
                action.finish(id, answer, **more)

    def _do_path(self, values: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        path = EndEffectorPath(values["id"], **arrays)
        self._path = pose_messages.path_message(path, values["start_ns"], values["frame"])
        self._paths.publish(self._path)

    def _do_report(self, values: dict[str, Any], _: object) -> None:
        if any(later is not None and later.values["what"] == "report" for later in self._inbox):
            return  # reports that waited for the start of this process are out of date
        parts = (values[key] for key in ("name", "hardware_id", "level", "text", "values"))
        self._diagnostics.publish(diagnostics_message(time_message(values["stamp_ns"]), *parts))

    def _do_log(self, values: dict[str, Any], _: object) -> None:
        severity, name, text = (values[key] for key in ("severity", "name", "text"))
        log = get_logger(name)  # rclpy requires a separate line of code for each severity
        if severity == "error":
            log.error(text)
        elif severity == "warning":
            log.warning(text)
        else:
            log.info(text)
        level = getattr(Log, severity.upper().removesuffix("ING"))
        stamp = Clock().now().to_msg()
        self._log.publish(Log(stamp=stamp, level=level, name=name, msg=text))

    # From the network

    def _prepare(self, id: str, what: str, prepare: Callable[[], None]) -> Answer | None:
        """Prepare what a request is about and hand it over, or say why it is refused."""
        if self._settings is None:
            return NOT_ACTIVE
        self._channel.send({"what": "reading", "id": id})
        try:
            prepare()
        except ControllerError as error:
            code = Code(error.refusal.value)
            return Answer(code, self._refuse(what, str(error)), speed=error.speed)
        except ValueError as error:
            return Answer(Code.REFUSED, self._refuse(what, str(error)))
        except Exception as error:  # of any kind: the process goes on
            return Answer(Code.REFUSED, self._refuse(what, repr(error)))
        return None

    def _refuse(self, what: str, text: str) -> str:
        """Report a refusal; returns its text."""
        self._channel.send({"what": "refused", "kind": what, "text": text[:TEXT_MAX]})
        return text[:TEXT_MAX]

    def _cancel(self, id: str) -> None:
        self._channel.send({"what": "cancel", "id": id})

    def _of_policy(self, do: str) -> Begin:
        """Begin of an action that is about a policy."""

        def begin(id: str, goal: ExecutePolicy.Goal | MoveToStart.Goal) -> Answer | None:
            asked = sent_ns(id), goal.known_stop
            return self._prepare(
                id, REQUEST, lambda: self._prepare_policy(id, do, goal.policy, asked)
            )

        return begin

    def _prepare_policy(self, id: str, do: str, message: Policy, asked: tuple[int, str]) -> None:
        settings, limits = self._arm()
        policy = policies.from_json(message.text)
        if message.id not in ("", policy.id):
            raise ValueError(f"the policy {policy.id!r} is named {message.id!r} in the goal")
        prepared = vars(policy_preparation.prepare(policy, limits, settings))
        arrays = {name: each for name, each in prepared.items() if isinstance(each, np.ndarray)}
        rest = {name: each for name, each in prepared.items() if name not in arrays}
        self._asked[id] = Policy(id=policy.id, text=message.text)
        values = {"what": "policy", "id": id, "do": do, "asked": asked, "policy": rest}
        self._hand_over(REQUEST, values, arrays)

    def _replay(self, id: str, goal: Replay.Goal) -> Answer | None:
        asked = sent_ns(id), goal.known_stop
        return self._prepare(id, MOVEMENT, lambda: self._prepare_movement(id, goal.movement, asked))

    def _follow(self, id: str, goal: FollowJointTrajectory.Goal) -> Answer | None:
        asked = sent_ns(id), ""
        return self._prepare(
            id, MOVEMENT, lambda: self._prepare_movement(id, goal.trajectory, asked, waypoints=True)
        )

    def _on_movement(self, data: bytes, info: dict[str, int]) -> None:
        """Take a movement from the topic, whose sender gets no answer."""
        asked, id = (info["source_timestamp"], ""), uuid4().hex

        def prepare() -> None:
            if (size := len(data)) > SIZE_MAX:
                raise ValueError(f"{size} bytes; at most {SIZE_MAX} allowed")
            message = deserialize_message(data, JointTrajectory)
            self._prepare_movement(id, message, asked, waypoints=True)

        if (answer := self._prepare(id, MOVEMENT, prepare)) is not None:
            self.get_logger().warning(f"movement refused: {answer.text}")

    def _prepare_movement(
        self,
        id: str,
        message: JointTrajectory,
        asked: tuple[int, str],
        waypoints: bool = False,
    ) -> None:
        settings, limits = self._arm()
        if (points := len(message.points)) > POINTS_MAX:
            raise ValueError(f"{points} points; at most {POINTS_MAX} allowed")
        t, q = joint_messages.movement(message, self._joint_names)
        if waypoints:
            t, q = replay_trajectory.through(t, q)
        sampled = replay_trajectory.sampled(t, q, settings.period, limits)
        values = {"duration": sampled.duration, "period": sampled.period}
        arrays = {"q": sampled.q, "qd": sampled.qd, "qdd": sampled.qdd}
        about = {"what": "movement", "id": id, "movement": values, "asked": asked}
        self._hand_over(MOVEMENT, about, arrays)

    def _arm(self) -> tuple[ControllerSettings, Limits]:
        """Settings and limits of the arm."""
        return self._settings, self._settings.limits

    def _hand_over(self, what: str, values: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        shared = self._channel.send({**values, "configuration": self._configuration}, arrays)
        self._shared[what].append(shared)


def followed(answer: Answer, **_: object) -> FollowJointTrajectory.Result:
    """Result of a FollowJointTrajectory that ended with an answer."""
    result = FollowJointTrajectory.Result(error_string=answer.text)
    if answer.code in (Code.REFUSED, Code.TOO_FAST):
        result.error_code = result.INVALID_GOAL
    elif not answer.success:
        result.error_code = result.PATH_TOLERANCE_VIOLATED
    return result


def main() -> int:
    """Run until the torque controller has ended, and END_TIMEOUT at most; signals are blocked."""
    channel = channel_of_process()
    with node_runner.participant(lambda: PreparationWorker(channel)) as node:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not node.ended:
            executor.spin_once(timeout_sec=1.0)
        faulthandler.dump_traceback_later(END_TIMEOUT, exit=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
