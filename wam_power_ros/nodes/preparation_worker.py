# SPDX-License-Identifier: Apache-2.0
"""Process beside the torque controller: takes its requests, answers, publishes and logs.

Started by `preparation.Preparation`, with plain scheduling and its own node; ends with the
controller. It hands requests over with what they are about: policies with their tables, and
movements sampled on the control grid.
"""

from __future__ import annotations

import faulthandler
import math
import sys
import threading
from collections import defaultdict, deque
from contextlib import suppress
from functools import partial
from typing import Any, TypeAlias
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
from trajectory_msgs.msg import JointTrajectory

from wam_power_interfaces.action import ExecutePolicy, MoveToStart, Replay
from wam_power_interfaces.msg import Policy, RolloutEnd
from wam_power_ros.control import policy_preparation, replay_trajectory
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.joint_references import Sampled
from wam_power_ros.control.modes import ControllerError
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.dmp import TabulatedPolicy
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.nodes.preparation import NAME, channel_of_process, settings_of
from wam_power_ros.ros import interface, joint_messages, node_runner, pose_messages
from wam_power_ros.ros.action_server import Action
from wam_power_ros.ros.diagnostics import diagnostics_message
from wam_power_ros.ros.outcomes import NOT_ACTIVE, Answer, Code, Ended
from wam_power_ros.ros.process_channel import Channel, Message
from wam_power_ros.ros.stamps import sent_ns, time_message

POINTS_MAX = 200_000  # of a movement, where the 600 s that may be replayed have 60 000
Goal: TypeAlias = Any  # of any of the actions
TEXT_MAX = 2000  # characters of a refusal
STAGE = "moving"  # of a request, once the arm moves
# [s] Fast DDS may wait in its own end for ever, on one core, while another participant leaves.
END_TIMEOUT = 10.0


class PreparationWorker(Node):
    """Node of the process; `ended` once the controller has, or has closed the channel."""

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
        self._shared: defaultdict[type, deque[object]] = defaultdict(lambda: deque(maxlen=2))
        self._path = Path()  # of the last rollout
        publish, latched = self.create_publisher, interface.LATCHED
        self._paths = publish(Path, interface.ROLLOUT_END_EFFECTOR, latched)
        self._policies = publish(Policy, interface.POLICY, latched)
        self._ends = publish(RolloutEnd, interface.ROLLOUT_END, latched)
        qos = interface.STATE_OUT
        self._diagnostics = publish(DiagnosticArray, interface.DIAGNOSTICS, qos)
        self._log = publish(Log, interface.LOG, interface.LOG_QOS)
        cancel = lambda id: channel.send({"what": "cancel", "id": id})  # noqa: E731
        self._actions = [
            Action(self, kind, name, partial(self._begin, action), cancel, result)
            for kind, name, action, result in (
                (ExecutePolicy, interface.EXECUTE_POLICY, "execute", None),
                (MoveToStart, interface.MOVE_TO_START, "move_to_start", None),
                (Replay, interface.REPLAY_MOVEMENT, "replay", None),
                (FollowJointTrajectory, interface.FOLLOW_TRAJECTORY, "replay", followed),
            )
        ]
        topic, qos = interface.REPLAY, interface.STATE_OUT
        self.create_subscription(JointTrajectory, topic, self._on_movement, qos)
        # Not Executor.wake(), after which the executor waits again without calling anything.
        self._arrived = self.create_guard_condition(self._handle_messages)
        threading.Thread(target=self._listen, daemon=True).start()

    # From the torque controller

    def _listen(self) -> None:
        """Receive into `_inbox`, because the executor can wait only for the middleware."""
        with suppress(rclpy_implementation.InvalidHandle):  # the node has ended first
            message: Message | None = Message({}, {})
            while message is not None:
                try:
                    message = self._channel.receive()
                except EOFError:
                    message = None
                self._inbox.append(message)
                self._arrived.trigger()

    def _handle_messages(self) -> None:
        while self._inbox:
            message = self._inbox.popleft()
            if message is None:
                self.ended = True
                return
            values = dict(message.values)
            getattr(self, f"_do_{values.pop('what')}")(**values, **message.arrays)

    def _do_configure(
        self, number: int, settings: dict[str, Any] | None, joint_names: list[str]
    ) -> None:
        self._configuration, self._joint_names = number, tuple(joint_names)
        self._settings = None if settings is None else settings_of(settings)

    def _do_begun(self, id: str) -> None:
        if id in self._asked:
            self._policies.publish(self._asked[id])
        for action in self._actions:
            action.report(id, STAGE)

    def _do_ended(self, id: str, answer: dict[str, Any], end: dict[str, Any] | None = None) -> None:
        more: dict[str, Any] = {}
        if end is not None:
            fault = end["fault"] and Fault(FaultKind(end["fault"]["kind"]), end["fault"]["text"])
            more = {"end": Ended(**{**end, "fault": fault}).message(), "path": self._path}
            self._ends.publish(more["end"])
        self._asked.pop(id, None)
        for action in self._actions:
            action.finish(id, Answer(**{**answer, "code": Code(answer["code"])}), **more)

    def _do_path(self, id: str, start_ns: int, frame: str, **arrays: np.ndarray) -> None:
        self._path = pose_messages.path_message(EndEffectorPath(id, **arrays), start_ns, frame)
        self._paths.publish(self._path)

    def _do_report(self, stamp_ns: int, **status: Any) -> None:  # noqa: ANN401 - of JSON
        if any(later is not None and later.values["what"] == "report" for later in self._inbox):
            return  # reports that waited for the start of this process are out of date
        self._diagnostics.publish(diagnostics_message(time_message(stamp_ns), **status))

    def _do_log(self, severity: str, name: str, text: str) -> None:
        log = get_logger(name)  # rclpy requires a separate line of code for each severity
        if severity == "error":
            log.error(text)
        elif severity == "warning":
            log.warning(text)
        else:
            log.info(text)
        level = getattr(Log, severity.upper().removesuffix("ING"))
        self._log.publish(Log(stamp=Clock().now().to_msg(), level=level, name=name, msg=text))

    # From the network

    def _on_movement(self, message: JointTrajectory, info: dict[str, int]) -> None:
        """Take a movement from the topic, whose sender gets no answer."""
        goal = FollowJointTrajectory.Goal(trajectory=message)
        answer = self._begin("replay", uuid4().hex, goal, info["source_timestamp"])
        if answer is not None:
            self.get_logger().warning(f"movement refused: {answer.text}")

    def _begin(self, action: str, id: str, goal: Goal, sent: int | None = None) -> Answer | None:
        """Hand over what a goal is about, or say why not; `sent` [ns], or as its id says."""
        if self._settings is None:
            return NOT_ACTIVE
        self._channel.send({"what": "reading", "id": id})
        try:
            replay = action == "replay"
            payload = self._movement(goal) if replay else self._policy(id, goal.policy)
            parts = vars(payload).items()
            arrays = {name: each for name, each in parts if isinstance(each, np.ndarray)}
            values = {name: each for name, each in parts if name not in arrays}
            asked = {"what": "asked", "id": id, "action": action, "payload": values}
            asked |= {"sent_ns": sent or sent_ns(id), "known_stop": getattr(goal, "known_stop", "")}
            asked |= {"configuration": self._configuration}
            shared = self._channel.send(asked, arrays)
            self._shared[type(payload)].append(shared)
        except ControllerError as error:
            text, code, speed = str(error), Code(error.refusal.value), error.speed
        except Exception as error:  # of any kind: the process goes on
            text = str(error) if isinstance(error, ValueError) else repr(error)
            code, speed = Code.REFUSED, math.nan
        else:
            return None
        self._channel.send({"what": "refused", "text": text[:TEXT_MAX]})
        return Answer(code, text[:TEXT_MAX], speed=speed)

    def _policy(self, id: str, message: Policy) -> TabulatedPolicy:
        policy = policies.from_json(message.text)
        if message.id not in ("", policy.id):
            raise ValueError(f"the policy {policy.id!r} is named {message.id!r} in the goal")
        prepared = policy_preparation.prepare(policy, self._settings.limits, self._settings)
        self._asked[id] = Policy(id=policy.id, text=message.text)
        return prepared

    def _movement(self, goal: Replay.Goal | FollowJointTrajectory.Goal) -> Sampled:
        """Movement of a goal, on the control grid: recorded, or through waypoints."""
        waypoints, settings = isinstance(goal, FollowJointTrajectory.Goal), self._settings
        message = goal.trajectory if waypoints else goal.movement
        if (points := len(message.points)) > POINTS_MAX:
            raise ValueError(f"{points} points; at most {POINTS_MAX} allowed")
        t, q = joint_messages.movement(message, self._joint_names)
        if waypoints:
            t, q = replay_trajectory.through(t, q)
        return replay_trajectory.sampled(t, q, settings.period, settings.limits)


def followed(answer: Answer, **_: object) -> FollowJointTrajectory.Result:
    """Result of a FollowJointTrajectory that ended with an answer."""
    result = FollowJointTrajectory.Result(error_string=answer.text)
    if answer.code in (Code.FAULT, Code.STOPPED):  # all others before it moved
        result.error_code = result.PATH_TOLERANCE_VIOLATED
    elif not answer.success:
        result.error_code = result.INVALID_GOAL
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
