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
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path as FilePath
from typing import Any

from nav_msgs.msg import Odometry, Path
from rclpy.duration import Duration
from std_msgs.msg import String

from wam_power_ros.client.link import Link
from wam_power_ros.client.reports import ControllerReports
from wam_power_ros.control.modes import Mode
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout
from wam_power_ros.ros import interface, pose_messages
from wam_power_ros.ros.answers import Answer, Code, ServiceError
from wam_power_ros.ros.pose_messages import PathReading, StateReading
from wam_power_ros.tasks.task import MISSING_MAX

STARTS_MAX = 5  # attempts to begin one rollout
ANSWER_TIMEOUT = 10.0  # after which an answer counts as lost [s of wall time]
RECEIPT_TIMEOUT = 20.0  # longest wait until all readers have a policy; DDS drops a dead one [s]
CLOCK_OFFSET_MAX = 0.2  # between arm and motion capture; the tracker allows no more [s]
READY_TIMEOUT = 10.0  # after which the scene is reset again [s of wall time]
SENDERS_LOG_PERIOD = 20.0  # between two lines about several publishers of policies [s]
SWITCH_LOG_PERIOD = 5.0  # between two lines about the enabling switch [s]
READY_STATES = 3  # number of successive states in which the body must be ready
NO_ANSWER = Answer(Code.UNKNOWN, "no answer")
INACTIVE_MODES = ("", "unconfigured", Mode.INACTIVE.value)  # the first before any is known
Ready = Callable[[StateReading | None], str]  # what is missing before a rollout, empty if nothing


class RolloutError(ServiceError):
    """The rollout cannot be executed; the message names what did not happen or was refused."""


class NotBegunError(RolloutError):
    """As far as is known, the rollout has not begun: a fault came first, or no answer."""


@dataclass(frozen=True)
class RolloutSettings:
    """Settings of the execution of rollouts, as in config/learner.yaml.

    Attributes:
        scene_reset: Whether the stand-in puts the scene back; otherwise a person does.
        reset_faults: Whether the controller is reset after a fault; otherwise a person does.
        record_rollouts: Whether to record each rollout.
        service_timeout: Time for a service to appear and to succeed [s of wall time].
        rollout_timeout: Time for the end of a rollout and for its paths [s of wall time].
        patience: Time for the arm to reach its start, and for the body [s of wall time].
    """

    scene_reset: bool
    reset_faults: bool
    record_rollouts: bool
    service_timeout: float
    rollout_timeout: float
    patience: float

    @classmethod
    def of(cls, learner: Mapping[str, Any]) -> RolloutSettings:
        """Settings among the parameters of a learner."""
        return cls(**{each.name: learner[each.name] for each in fields(cls)})


@dataclass(frozen=True)
class Executed:
    """A rollout that has been executed."""

    rollout: Rollout
    bag: str  # name of its recording, empty without one
    truth: dict[str, Any] | None  # ground truth of the simulator, None on hardware


class _Readiness:
    """Successive states in which the body was ready, and what was missing in the last one."""

    def __init__(self, ready: Ready, body: str) -> None:
        self._ready, self._missing = ready, f"no state of the {body} received"
        self.count = self.stamp_ns = 0  # successive states; stamp of the last one

    def add(self, state: StateReading) -> None:
        """Judge the next state."""
        self._missing, self.stamp_ns = self._ready(state), state.stamp_ns
        self.count = 0 if self._missing else self.count + 1

    def __str__(self) -> str:
        """Return what is missing, for messages."""
        return self._missing or f"fewer than {READY_STATES} states in a row"


class Rollouts:
    """Executes policies through the services of controller, recorder and stand-in.

    Args:
        link: Link in whose namespace the nodes run.
        settings: Settings.
        body: Name of the tracked body, "" for none.
    """

    def __init__(self, link: Link, settings: RolloutSettings, body: str) -> None:
        self._link, self._node, self._log = link, link.node, link.node.get_logger()
        self._settings, self._body, self._reports = settings, body, ControllerReports(link)
        self._readiness = _Readiness(lambda state: "no rollout is prepared", body)
        self._policies = self._node.create_publisher(String, interface.POLICY, interface.LATCHED)
        self._reset = interface.body_topic(body, "reset")
        self._truth_topic = interface.body_topic(body, "truth")
        last, path = link.last, pose_messages.path
        self._finished = last(String, interface.ROLLOUT_FINISHED, pose_messages.finished)
        self._tool_path = last(Path, interface.ROLLOUT_END_EFFECTOR, path)
        self._truth = last(String, self._truth_topic, pose_messages.ground_truth)
        if body:
            self._body_path = last(Path, interface.rollout_topic(body), path)
            states = interface.body_topic(body, "state")
            link.listen(Odometry, states, self._on_state, interface.STATE_OUT)
        link.prepare(interface.MOVE_TO_START, interface.EXECUTE, interface.RESET, self._reset)
        link.prepare(interface.RECORD, data=True)

    def _on_state(self, message: Odometry) -> None:
        self._readiness.add(pose_messages.odometry(message))

    def execute(self, policy: Policy, duration: float, ready: Ready) -> Executed:
        """Execute a policy once.

        Args:
            policy: Policy to execute.
            duration: Duration of its complete rollout [s].
            ready: Returns what is missing before it may begin, empty if nothing.

        Raises:
            RolloutError: It could not be begun, or its end did not come in time.
            ServiceError: A service did not appear.
            ValueError: A path is not valid.
        """
        for attempt in range(STARTS_MAX):
            try:
                ready_ns = self._start(policy, ready)
                break
            except NotBegunError as error:  # the trial is not counted
                self._log.warning(f"{policy.id} is started again: {error}")
                if attempt == STARTS_MAX - 1:
                    raise
        return self._collect(policy, duration, ready_ns)

    def until(
        self, condition: Callable[[], object], what: str | Callable[[], str], timeout: float
    ) -> None:
        """Wait until a condition holds, see `Link.until`.

        While simulated time advances, the timeout must have passed in it, too: a busy machine is
        not an error.

        Raises:
            RolloutError: It did not come true within `timeout` [s of wall time].
        """
        clock = self._node.get_clock()
        begun = last = clock.now()
        while not self._link.until(condition, what, timeout):
            now = clock.now()
            advances = clock.ros_time_is_active and now > last
            if not advances or (now - begun).nanoseconds > timeout * 1e9:
                awaited = what() if callable(what) else what
                raise RolloutError(f"waited {timeout:.0f} s in vain for {awaited}")
            last = now

    # Services

    def _call(self, name: str, data: bool | None = None) -> Answer:
        """Answer of a service; of code UNKNOWN if none came."""
        deadline = time.monotonic() + ANSWER_TIMEOUT

        def lost() -> bool:  # a move is answered when the arm has arrived
            mode, start = self._reports.mode, interface.MOVE_TO_START
            moving = name == start and mode == Mode.MOVE_TO_START.value
            return time.monotonic() > deadline and not moving

        answer = self._link.call(name, data, self._settings.patience, abandon=lost)
        if answer is None:
            self._log.warning(f"no answer from {self._node.resolve_service_name(name)}")
        return answer or NO_ANSWER

    def _insist(self, name: str, policy_id: str) -> None:
        """Call a service until it has succeeded for this policy.

        Topics and services are not ordered: a request that arrives before the policy is refused, or
        answered for the last one. Waits without limit for a person to hold the enabling switch.
        """
        end = time.monotonic() + self._settings.service_timeout
        while True:
            answer = self._call(name)
            if answer.success and _is_about(answer, policy_id):
                return
            # With no answer it may have been done: it is begun again rather than done twice. An arm
            # that has left the start has executed a call that was given up as lost.
            left = answer.code is Code.NOT_AT_START and _is_about(answer, policy_id)
            if answer is NO_ANSWER or answer.code in (Code.FAULT, Code.NOT_ACTIVE) or left:
                fault = self._reports.fault
                reason = f" ({fault.text})" if fault else ""
                raise NotBegunError(f"{name}: {answer.text}{reason}")
            if answer.code is Code.SWITCH:
                text = f"waiting for the enabling switch to be held, for {policy_id}"
                self._log.info(text, throttle_duration_sec=SWITCH_LOG_PERIOD)
            elif time.monotonic() > end:
                raise RolloutError(f"{name} for {policy_id} failed: {answer}")
            self._link.sleep(0.05)

    def _begin_bag(self, policy_id: str) -> None:
        answer = self._call(interface.RECORD, True)
        if not answer.success and self._end_bag():  # of a killed learner
            answer = self._call(interface.RECORD, True)
        if not answer.success:
            self._log.warning(f"{policy_id} is not recorded: {answer}")

    def _end_bag(self) -> str:
        """End the recording; returns the name of the bag, empty without one."""
        answer = self._call(interface.RECORD, False)
        return FilePath(answer.text).name if answer.success else ""

    # One rollout

    def _start(self, policy: Policy, ready: Ready) -> int:
        """Begin the rollout of a policy.

        Returns:
            Stamp of a state at which the body was ready before it [ns], 0 without a body.

        Raises:
            NotBegunError: The controller had a fault before, or did not answer.
        """
        ready_ns = self._await_body(policy, ready)
        if self._settings.record_rollouts:
            self._begin_bag(policy.id)
        self._reports.fault = None
        self._insist(interface.EXECUTE, policy.id)
        return ready_ns

    def _await_body(self, policy: Policy, ready: Ready) -> int:
        """Move the arm to the start of the policy, and wait until the body is ready there.

        In simulation the scene is reset, repeatedly if needed: a request that was given up as lost
        may be served late and throw the body off. On hardware a person has `patience` for it.
        """
        end = time.monotonic() + self._settings.patience
        scene_reset = self._settings.scene_reset
        while True:
            self._reach_start(policy)
            if scene_reset:
                self._insist(self._reset, policy.id)
            if not self._body:
                return 0
            self._readiness = readiness = _Readiness(ready, self._body)
            try:
                self.until(
                    lambda: readiness.count >= READY_STATES,  # noqa: B023 - called at once
                    lambda: f"the {self._body} to be ready: {readiness}",  # noqa: B023
                    READY_TIMEOUT if scene_reset else self._settings.patience,
                )
                return readiness.stamp_ns
            except RolloutError:
                if not scene_reset or time.monotonic() > end:
                    raise
                self._log.warning(f"the scene is reset again: {readiness}")

    def _reach_start(self, policy: Policy) -> None:
        """Move the arm to the start of the policy, after a reset of a fault if needed.

        Waits without limit for a person to activate the controller.
        """
        end = time.monotonic() + self._settings.patience
        late = time.monotonic() + RECEIPT_TIMEOUT  # readers not discovered yet have no policy
        text = policies.to_json(policy)
        digest = policies.digest(text)
        if self._node.count_publishers(self._policies.topic_name) > 1:
            self._log.warning(self._senders(), throttle_duration_sec=SENDERS_LOG_PERIOD)
        while True:  # publish each time: a policy is refused in a rollout, as of a killed learner
            self._link.wait_for(interface.MOVE_TO_START)
            self._policies.publish(String(data=text))
            # Topics and services are not ordered: the move could be to the last policy's start.
            received = partial(self._policies.wait_for_all_acked, Duration(nanoseconds=1))
            self._link.until(received, "all readers to have the policy", RECEIPT_TIMEOUT)
            answer = self._call(interface.MOVE_TO_START)
            if answer.success and _is_about(answer, policy.id):
                if answer.values.get("digest", digest) == digest:
                    return
                answer = replace(answer, text=f"another policy with this id: {self._senders()}")
            if answer.code is Code.NOT_ACTIVE:
                self._await_activation()
                end = time.monotonic() + self._settings.patience
                continue
            if time.monotonic() > end:
                raise RolloutError(f"{interface.MOVE_TO_START} for {policy.id} failed: {answer}")
            if answer.code is Code.FAULT and self._settings.reset_faults:
                self._call(interface.RESET)
            elif answer.code is not Code.NOTHING or time.monotonic() > late:
                self._log.warning(f"the arm cannot move to its start yet: {answer}", once=True)
            self._link.sleep(0.1)

    def _senders(self) -> str:
        """Publishers of policies, as text; the last message of any of them is executed."""
        senders = interface.publishers(self._node, self._policies.topic_name)
        return f"{', '.join(senders)} publish {self._policies.topic_name}"

    def _await_activation(self) -> None:
        """Wait until the diagnostics say that the controller is active."""
        self._reports.mode = ""  # the last one may be out of date
        self.until(
            lambda: self._reports.mode not in INACTIVE_MODES,
            "the torque controller to be active (ros2 lifecycle set)",
            math.inf,
        )

    def _collect(self, policy: Policy, duration: float, ready_ns: int) -> Executed:
        """Wait for the end of the rollout that began after the body was ready, and its messages.

        The latched topics may still have those of an earlier rollout of the same trial, whose
        learner was killed; all messages of one rollout have the stamp of its start.
        """
        earliest_ns = ready_ns - round(CLOCK_OFFSET_MAX * 1e9)

        def awaited(last: Callable[[], Any], fits: Callable[[Any], bool], what: str) -> Any:  # noqa: ANN401
            found: list[Any] = []

            def there() -> bool:
                found[:] = [message for message in [last()] if message and fits(message)]
                return bool(found)

            self.until(there, f"the {what} of {policy.id}", self._settings.rollout_timeout)
            return found[0]

        def same(path: PathReading) -> bool:
            return path.start_ns == finished.start_ns

        finished = awaited(
            self._finished, lambda it: it.id == policy.id and it.start_ns >= earliest_ns, "end"
        )
        tool = EndEffectorPath(policy.id, *awaited(self._tool_path, same, "path of the tool")[1:])
        body = truth = None
        if self._body:
            path = awaited(self._body_path, same, f"path of the {self._body}")
            body = BodyPath(policy.id, *path[1:])
        bag = self._end_bag() if self._settings.record_rollouts else ""
        if self._node.count_publishers(self._truth_topic):
            truth = awaited(
                self._truth,
                lambda it: it.values.get("id") == policy.id and it.end_ns >= finished.start_ns,
                "ground truth",
            ).values
        fault = finished.fault if tool.t[-1] < duration - MISSING_MAX else None
        if finished.digest not in ("", policies.digest(policies.to_json(policy))):
            text = f"another policy was executed under the id {policy.id}: {self._senders()}"
            self._log.error(text)
            fault = Fault(FaultKind.OTHER_POLICY, text)
        return Executed(Rollout(tool, body, fault, finished.stopped_in), bag, truth)


def _is_about(answer: Answer, policy_id: str) -> bool:
    return answer.values.get("policy") == policy_id
