# SPDX-License-Identifier: Apache-2.0
"""Execution of a trial over ROS: policy out, services called, paths of the finished rollout in.

Publish the policy, move the arm to its start, wait until the body is ready, begin a recording,
execute, and collect the paths, the fault and the recording. Requests and answers can be lost and
nodes can be restarted: no single answer is awaited for long, and what may have begun is repeated
from the start of the trial.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path as FilePath
from typing import Any, Protocol, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry, Path
from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.control.modes import Mode
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout
from wam_power_ros.ros import diagnostics, interface, pose_messages
from wam_power_ros.ros.answers import Answer, Code
from wam_power_ros.ros.pose_messages import Finished, GroundTruth, PathReading, StateReading
from wam_power_ros.ros.service_client import ServiceClient, ServiceError
from wam_power_ros.tasks.task import MISSING_MAX

T = TypeVar("T")
STARTS_MAX = 5  # attempts to begin one rollout
ANSWER_TIMEOUT = 10.0  # after which an answer counts as lost [s of wall time]
RECEIPT_TIMEOUT = 20.0  # longest wait until all readers have a policy; DDS drops a dead one [s]
CLOCK_OFFSET_MAX = 0.2  # between arm and motion capture; the tracker allows no more [s]
READY_TIMEOUT = 10.0  # after which the scene is reset again [s of wall time]
SENDERS_LOG_PERIOD = 20.0  # between two lines about several publishers of policies [s]
SWITCH_LOG_PERIOD = 5.0  # between two lines about the enabling switch [s]
READY_STATES = 3  # number of successive states in which the body must be ready
TOO_FEW_STATES = f"fewer than {READY_STATES} states in a row"
INACTIVE_MODES = ("", "unconfigured", Mode.INACTIVE.value)  # the first before any is known
Ready = Callable[[StateReading | None], str]  # what is missing before a rollout, empty if nothing


class RolloutError(RuntimeError):
    """The rollout cannot be executed; the message names what did not happen or was refused."""


class NotBegunError(RolloutError):
    """As far as is known, the rollout has not begun: a fault came first, or no answer."""


class RolloutParams(Protocol):
    """Parameters of the node that concern the execution of rollouts."""

    scene_reset: bool
    reset_faults: bool
    record_rollouts: bool
    service_timeout: float
    rollout_timeout: float
    patience: float


@dataclass(frozen=True)
class Executed:
    """A rollout that has been executed."""

    rollout: Rollout
    bag: str  # name of its recording, empty without one
    truth: dict[str, Any] | None  # ground truth of the simulator, None on hardware


class RolloutClient:
    """Executes policies through the services of controller, recorder and stand-in."""

    def __init__(self, node: Node, executor: Executor, params: RolloutParams, body: str) -> None:
        """Create the publishers, subscriptions and clients on `node`.

        Args:
            node: Node that executes rollouts.
            executor: Executor of the node, used while waiting.
            params: Parameters of the node.
            body: Name of the tracked body, "" for none.
        """
        self._node = node
        self._log = node.get_logger()
        self._params = params
        self._services = ServiceClient(node, executor, params.service_timeout)
        self._body = body
        self._finished: Finished | None = None
        self._tool_path: PathReading | None = None
        self._body_path: PathReading | None = None
        self._truth: GroundTruth | None = None
        self._fault: Fault | None = None
        self._mode = ""  # of the controller, published once a second
        self._ready: Ready = lambda state: "no rollout is prepared"
        self._missing = ""
        self._ready_states = 0  # successive states in which the body was ready
        self._ready_ns = 0  # stamp of the last one
        self._policies = node.create_publisher(String, interface.POLICY, interface.LATCHED)
        self._reset = interface.body_topic(body, "reset")
        self._truth_topic = interface.body_topic(body, "truth")
        subscribe = node.create_subscription
        subscribe(Path, interface.ROLLOUT_END_EFFECTOR, self._on_tool_path, interface.LATCHED)
        subscribe(String, interface.ROLLOUT_FINISHED, self._on_finished, interface.LATCHED)
        subscribe(String, self._truth_topic, self._on_truth, interface.LATCHED)
        subscribe(
            DiagnosticArray, interface.DIAGNOSTICS, self._on_diagnostics, interface.DIAGNOSTICS_QOS
        )
        if body:
            path, state = interface.rollout_topic(body), interface.body_topic(body, "state")
            subscribe(Path, path, self._on_body_path, interface.LATCHED)
            subscribe(Odometry, state, self._on_state, interface.STATE_OUT)
        for name in (interface.MOVE_TO_START, interface.EXECUTE, interface.RESET, self._reset):
            self._services.prepare(Trigger, name)
        self._services.prepare(SetBool, interface.RECORD)

    def execute(self, policy: Policy, duration: float, ready: Ready) -> Executed:
        """Execute a policy once.

        Args:
            policy: Policy to execute.
            duration: Duration of its complete rollout [s].
            ready: Returns what is missing before it may begin, empty if nothing.

        Raises:
            RolloutError: It could not be begun, or its end did not come in time.
        """
        self._ready = ready
        for attempt in range(STARTS_MAX):
            try:
                ready_ns = self._start(policy)
                break
            except NotBegunError as error:  # the trial is not counted
                self._log.warning(f"{policy.id} is started again: {error}")
                if attempt == STARTS_MAX - 1:
                    raise
        finished = self._end(policy.id, ready_ns)
        digest = policies.digest(policies.to_json(policy))
        tool, body = self._paths(finished)
        bag = self._end_bag() if self._params.record_rollouts else ""
        truth = None
        if self._node.count_publishers(self._truth_topic):
            self.until(
                lambda: self._truth_of(finished) is not None,
                f"the ground truth of {policy.id}",
                self._params.rollout_timeout,
            )
            truth = self._truth_of(finished)
        fault = finished.fault if tool.t[-1] < duration - MISSING_MAX else None
        if finished.digest not in ("", digest):
            text = f"another policy was executed under the id {policy.id}: {self._senders()}"
            self._log.error(text)
            fault = Fault(FaultKind.OTHER_POLICY, text)
        return Executed(Rollout(tool, body, fault, finished.stopped_in), bag, truth)

    def until(
        self, condition: Callable[[], object], what: str | Callable[[], str], timeout: float
    ) -> None:
        """Spin until `condition()`; logs what it waits for, see `ServiceClient.until`.

        While simulated time advances, the timeout must have passed in it, too: a busy machine is
        not an error.

        Raises:
            RolloutError: It did not come true within `timeout` [s of wall time].
            ExternalShutdownException: The node was shut down meanwhile.
        """
        clock = self._node.get_clock()
        begun = last = clock.now()
        while not self._services.until(condition, what, timeout):
            now = clock.now()
            advances = clock.ros_time_is_active and now > last
            if not advances or (now - begun).nanoseconds > timeout * 1e9:
                awaited = what() if callable(what) else what
                raise RolloutError(f"waited {timeout:.0f} s in vain for {awaited}")
            last = now

    # Messages in

    def _on_finished(self, message: String) -> None:
        self._finished = self._read(lambda: pose_messages.finished(message))

    def _on_tool_path(self, message: Path) -> None:
        self._tool_path = self._read(lambda: pose_messages.path(message))

    def _on_body_path(self, message: Path) -> None:
        self._body_path = self._read(lambda: pose_messages.path(message))

    def _on_state(self, message: Odometry) -> None:
        state = self._read(lambda: pose_messages.odometry(message))
        if state is not None:
            self._missing = self._ready(state)
            self._ready_states = 0 if self._missing else self._ready_states + 1
            self._ready_ns = state.stamp_ns

    def _on_truth(self, message: String) -> None:
        self._truth = self._read(lambda: pose_messages.ground_truth(message))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = diagnostics.of_controller(self._node.get_namespace(), status)
            if values is not None:
                self._mode = values.get("mode", "")
                self._fault = None
                if status.level == DiagnosticStatus.ERROR:
                    kinds = {kind.value: kind for kind in FaultKind}
                    kind = kinds.get(values[diagnostics.FAULT_KIND], FaultKind.SOFTWARE)
                    self._fault = Fault(kind, status.message)

    def _read(self, convert: Callable[[], T]) -> T | None:
        try:
            return convert()
        except ValueError as error:
            self._log.warning(f"message ignored: {error}", throttle_duration_sec=1.0)
            return None

    # Services

    def _call(self, name: str, request: SetBool.Request | None = None) -> Answer | None:
        """Call a service; returns None if no answer came.

        Raises:
            RolloutError: The service is not offered in time.
        """
        deadline = time.monotonic() + ANSWER_TIMEOUT

        def lost() -> bool:  # a move is answered when the arm has arrived
            moving = name == interface.MOVE_TO_START and self._mode == Mode.MOVE_TO_START.value
            return time.monotonic() > deadline and not moving

        try:
            answer = self._services.call(
                Trigger if request is None else SetBool,
                name,
                request,
                self._params.patience,
                abandon=lost,
            )
        except ServiceError as error:
            raise RolloutError(str(error)) from error
        if answer is None:
            self._log.warning(f"no answer from {self._node.resolve_service_name(name)}")
        return answer

    def _record(self, begin: bool) -> Answer | None:
        return self._call(interface.RECORD, SetBool.Request(data=begin))

    def _begin_bag(self, policy_id: str) -> None:
        answer = self._record(True)
        if (answer is None or not answer.success) and self._end_bag():  # of a killed learner
            answer = self._record(True)
        if answer is None or not answer.success:
            self._log.warning(f"{policy_id} is not recorded: {answer or 'no answer'}")

    def _end_bag(self) -> str:
        """End the recording; returns the name of the bag, empty without one."""
        answer = self._record(False)
        return FilePath(answer.text).name if answer is not None and answer.success else ""

    # One rollout

    def _start(self, policy: Policy) -> int:
        """Begin the rollout of a policy.

        Returns:
            Stamp of a state at which the body was ready before it [ns], 0 without a body.

        Raises:
            NotBegunError: The controller had a fault before, or did not answer.
        """
        self._await_body(policy)
        ready_ns = self._ready_ns
        if self._params.record_rollouts:
            self._begin_bag(policy.id)
        self._fault = None
        self._insist(interface.EXECUTE, policy.id)
        return ready_ns

    def _await_body(self, policy: Policy) -> None:
        """Move the arm to the start of the policy, and wait until the body is ready there.

        In simulation the scene is reset, repeatedly if needed: a request that was given up as lost
        may be served late and throw the body off. On hardware a person has `patience` for it.
        """
        end = time.monotonic() + self._params.patience
        scene_reset = self._params.scene_reset
        while True:
            self._reach_start(policy)
            if scene_reset:
                self._insist(self._reset, policy.id)
            self._ready_states = self._ready_ns = 0
            self._missing = f"no state of the {self._body} received"
            if not self._body:
                return
            try:
                self.until(
                    lambda: self._ready_states >= READY_STATES,
                    lambda: f"the {self._body} to be ready: {self._missing or TOO_FEW_STATES}",
                    READY_TIMEOUT if scene_reset else self._params.patience,
                )
                return
            except RolloutError:
                if not scene_reset or time.monotonic() > end:
                    raise
                self._log.warning(f"the scene is reset again: {self._missing or TOO_FEW_STATES}")

    def _reach_start(self, policy: Policy) -> None:
        """Move the arm to the start of the policy, after a reset of a fault if needed.

        Waits without limit for a person to activate the controller.
        """
        end = time.monotonic() + self._params.patience
        text = policies.to_json(policy)
        digest = policies.digest(text)
        if self._node.count_publishers(self._policies.topic_name) > 1:
            self._log.warning(self._senders(), throttle_duration_sec=SENDERS_LOG_PERIOD)
        late = time.monotonic() + RECEIPT_TIMEOUT  # readers not discovered yet have no policy
        while True:  # publish each time: a policy is refused in a rollout, as of a killed learner
            self._services.wait_for(Trigger, interface.MOVE_TO_START)
            self._policies.publish(String(data=text))
            # Topics and services are not ordered: the move could be to the last policy's start.
            received = partial(self._policies.wait_for_all_acked, Duration(nanoseconds=1))
            self._services.until(received, "all readers to have the policy", RECEIPT_TIMEOUT)
            answer = self._call(interface.MOVE_TO_START)
            if answer is not None and answer.success and _is_about(answer, policy.id):
                if answer.values.get("digest", digest) == digest:
                    return
                answer = replace(answer, text=f"another policy with this id: {self._senders()}")
            if answer is not None and answer.code is Code.NOT_ACTIVE:
                self._await_activation()
                end = time.monotonic() + self._params.patience
                continue
            if time.monotonic() > end:
                raise RolloutError(
                    f"{interface.MOVE_TO_START} for {policy.id} failed: {answer or 'no answer'}"
                )
            if answer is not None and answer.code is Code.FAULT and self._params.reset_faults:
                self._call(interface.RESET)
            elif answer is None or answer.code is not Code.NOTHING or time.monotonic() > late:
                self._log.warning(
                    f"the arm cannot move to its start yet: {answer or 'no answer'}", once=True
                )
            self._services.until(lambda: False, timeout=0.1)

    def _senders(self) -> str:
        """Publishers of policies, as text; the last message of any of them is executed."""
        senders = interface.publishers(self._node, self._policies.topic_name)
        return f"{', '.join(senders)} publish {self._policies.topic_name}"

    def _await_activation(self) -> None:
        """Wait until the diagnostics say that the controller is active."""
        self._mode = ""  # the last one may be out of date
        self.until(
            lambda: self._mode not in INACTIVE_MODES,
            "the torque controller to be active (ros2 lifecycle set)",
            math.inf,
        )

    def _insist(self, name: str, policy_id: str) -> None:
        """Call a service until it has succeeded for this policy.

        Topics and services are not ordered: a request that arrives before the policy is refused, or
        answered for the last one. Waits without limit for a person to hold the enabling switch.
        """
        end = time.monotonic() + self._params.service_timeout
        while True:
            answer = self._call(name)
            if answer is None:  # it may have been done: start again rather than do it twice
                raise NotBegunError(f"{name}: no answer")
            if answer.success and _is_about(answer, policy_id):
                return
            if answer.code is Code.FAULT:
                reason = "no reason reported yet" if self._fault is None else self._fault.text
                raise NotBegunError(f"{answer.text} ({reason})")
            if answer.code is Code.NOT_ACTIVE:
                raise NotBegunError(f"{name}: {answer.text}")
            if answer.code is Code.NOT_AT_START and _is_about(answer, policy_id):
                raise NotBegunError(f"{name}: {answer.text}")  # a call given up as lost was done
            if answer.code is Code.SWITCH:
                text = f"waiting for the enabling switch to be held, for {policy_id}"
                self._log.info(text, throttle_duration_sec=SWITCH_LOG_PERIOD)
            elif time.monotonic() > end:
                raise RolloutError(f"{name} for {policy_id} failed: {answer}")
            self._services.until(lambda: False, timeout=0.05)

    def _end(self, policy_id: str, ready_ns: int) -> Finished:
        """Wait for the end of the rollout that began after the body was ready.

        The latched topics may still have end and paths of an earlier rollout of the same trial,
        whose learner was killed.
        """
        earliest_ns = ready_ns - round(CLOCK_OFFSET_MAX * 1e9)

        def ended() -> bool:
            last = self._finished
            return last is not None and last.id == policy_id and last.start_ns >= earliest_ns

        self.until(ended, f"the end of {policy_id}", self._params.rollout_timeout)
        return self._finished

    def _paths(self, finished: Finished) -> tuple[EndEffectorPath, BodyPath | None]:
        """Wait for the paths of a finished rollout, which have its start stamp."""
        timeout = self._params.rollout_timeout
        self.until(
            lambda: _belongs_to(self._tool_path, finished),
            f"the path of the tool in {finished.id}",
            timeout,
        )
        if self._body:
            self.until(
                lambda: _belongs_to(self._body_path, finished),
                f"the path of the {self._body} in {finished.id}",
                timeout,
            )
        try:
            tool = EndEffectorPath(finished.id, *self._tool_path[1:])
            return tool, BodyPath(finished.id, *self._body_path[1:]) if self._body else None
        except ValueError as error:
            raise RolloutError(str(error)) from error

    def _truth_of(self, finished: Finished) -> dict[str, Any] | None:
        truth = self._truth
        if truth is None or truth.values.get("id") != finished.id:
            return None
        return truth.values if truth.end_ns >= finished.start_ns else None


def _is_about(answer: Answer, policy_id: str) -> bool:
    return answer.values.get("policy") == policy_id


def _belongs_to(path: PathReading | None, finished: Finished) -> bool:
    return path is not None and path.start_ns == finished.start_ns
