# SPDX-License-Identifier: Apache-2.0
"""Execution of a trial over ROS: policy out, paths of the finished rollout in.

Move the arm to the start of the policy, wait until the body is ready, begin a recording, execute,
and collect the paths, the fault and the recording. A node can be restarted: what may have begun is
repeated from the start of the trial.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any, Literal, NamedTuple

from nav_msgs.msg import Odometry, Path
from pydantic import BaseModel, ConfigDict

from wam_power_interfaces.action import ExecutePolicy, MoveToStart, Replay, ResetScene
from wam_power_interfaces.msg import GroundTruth
from wam_power_interfaces.msg import Policy as PolicyMessage
from wam_power_ros.client.actions import Action, Goal
from wam_power_ros.client.link import RETRY_PERIOD, Link
from wam_power_ros.client.reports import ControllerReports
from wam_power_ros.control.modes import Mode
from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import LEAD_TIME, BodyPath, EndEffectorPath, Rollout
from wam_power_ros.params.node_params import Timeout
from wam_power_ros.ros import interface, pose_messages
from wam_power_ros.ros.joint_messages import JointMovement, movement_message
from wam_power_ros.ros.outcomes import NO_ANSWER, Answer, Code, Ended, ServiceError
from wam_power_ros.ros.stamps import nanoseconds
from wam_power_ros.tasks.reset import Action as ResetAction
from wam_power_ros.tasks.reset import BodyState, Move, Resetting
from wam_power_ros.tasks.task import MISSING_MAX

STARTS_MAX = 5  # attempts to begin one rollout
TIMEOUTS_MAX = 5  # of a wait while simulated time advances
ANSWER_TIMEOUT = 10.0  # after which the answer of a service counts as lost [s of wall time]
READY_TIMEOUT = 10.0  # after which the scene is reset again [s of wall time]
BUSY_PERIOD = 0.02  # [s of wall time] to the next request to an arm that comes to rest
SWITCH_LOG_PERIOD = 5.0  # between two lines about the enabling switch [s]
SILENCE = 2.0  # without a state of the body, after which it counts as not seen [s of wall time]
NOT_BEGUN_CODES = (Code.UNKNOWN, Code.FAULT, Code.NOT_ACTIVE, Code.NOT_AT_START, Code.STOPPED)
INACTIVE_MODES = ("", "unconfigured", Mode.INACTIVE.value)  # the first before any is known
Ready = Callable[[BodyState | None], str]  # what is missing before a rollout, empty if nothing
ResetBody = Callable[[BodyState | None], ResetAction]  # what is to be done then


class Awaited(NamedTuple):
    """What is waited for, without limit, before a rollout goes on.

    "rest": the body comes to rest by itself; "not_visible": no state of it comes; otherwise what a
    person must do.
    """

    state: Literal["rest", "not_visible", "put back", "reset", "activate", "switch", "rate"]
    what: str  # noun phrase


class RolloutError(ServiceError):
    """The rollout cannot be executed; the message names what did not happen or was refused."""


class EndedByPersonError(ServiceError):
    """A person has stopped the arm or taken it in the hand: nothing moves until a person says so.

    `ran`: whether that ended the rollout; otherwise it came before. `bag`: name of its recording.
    """

    def __init__(self, answer: Answer, ran: bool = False) -> None:
        super().__init__(answer.text, answer)
        self.ran, self.bag = ran, ""


class NotBegunError(RolloutError):
    """As far as is known, the rollout has not begun: a fault came first, or no answer."""


class RolloutSettings(BaseModel):
    """Settings of the execution of rollouts, among the parameters of a learner."""

    model_config = ConfigDict(frozen=True)

    scene_reset: bool  # whether the stand-in puts the scene back; otherwise a person does
    reset_faults: bool  # whether the controller is reset after a fault; otherwise a person does it
    record_rollouts: bool
    service_timeout: Timeout  # for a service to appear and to succeed [s of wall time]
    rollout_timeout: Timeout  # for the end of a rollout and for its paths [s of wall time]
    # For the arm to reach its start, for a movement that puts the body back, and for a reset of the
    # scene [s of wall time].
    patience: Timeout


@dataclass(frozen=True)
class Executed:
    """A rollout that has been executed."""

    rollout: Rollout
    bag: str  # name of its recording, empty without one
    truth: dict[str, Any] | None  # ground truth of the simulator, None on hardware
    reset: dict[str, Any] | None = None  # who put the body back, in which time; None: the stand-in


class Rollouts:
    """Executes policies by actions of controller and stand-in, and services of the recorder.

    `motions` are actions of the controller, `reports` what it says. `awaited` returns what is
    waited for without limit, None if nothing; for every thread. Without the joint names of the
    driver a person puts the body back, not the arm.
    """

    def __init__(
        self, link: Link, settings: RolloutSettings, body: str, joint_names: Sequence[str] = ()
    ) -> None:
        self._link, self._node, self._log = link, link.node, link.node.get_logger()
        self._settings, self._body, self.reports = settings, body, ControllerReports(link)
        self._resetting = Resetting(lambda state: "no rollout is prepared", lambda state: "wait")
        self._known_stop: str | None = None  # None: of no session
        self._seen = time.monotonic()  # when the last state of the body came
        self._joint_names = joint_names
        self.awaited: Callable[[], Awaited | None] = _nothing
        self._execution = Action(link, ExecutePolicy, interface.EXECUTE_POLICY)
        self._to_start = Action(link, MoveToStart, interface.MOVE_TO_START)
        self._replays = Action(link, Replay, interface.REPLAY_MOVEMENT)
        self.motions = self._execution, self._to_start, self._replays
        self._scene = Action(link, ResetScene, interface.RESET_SCENE)
        self._truth_topic = interface.body_topic(body, "truth")
        last, path = link.last, pose_messages.path
        self._truth = last(GroundTruth, self._truth_topic, pose_messages.ground_truth)
        if body:
            self._body_path = last(Path, interface.rollout_topic(body), path)
            states = interface.body_topic(body, "state")
            link.listen(Odometry, states, self._on_state, interface.STATE_OUT)
        link.prepare(interface.RESET)
        link.prepare(interface.RECORD, data=True)

    def _on_state(self, message: Odometry) -> None:
        state, self._seen = pose_messages.odometry(message), time.monotonic()
        self._resetting.add(state, state.stamp_ns)

    def go_on(self) -> float:
        """Let a session go on after the last stop; a later one ends what it asks for.

        Returns when that stop was, by the clock of the controller [s]; 0 before the first.
        """
        self._known_stop = self.reports.last_stop
        return int(self._known_stop or 0) * 1e-9

    def execute(
        self,
        policy: Policy,
        duration: float,
        ready: Ready,
        reset_body: ResetBody = lambda state: "person",
        rest_time: float = 0.0,
    ) -> Executed:
        """Execute a policy once.

        Args:
            duration: Duration of its complete rollout [s].
            put_back: See `Task.reset`; a scene that is reset does not need it.
            rest_time: Time for which the body must have been ready [s].

        Raises:
            EndedByPersonError: A person has ended it, or a movement or wait before it.
            ServiceError: It could not be begun, or its end did not come in time.
            ValueError: A path is not valid.
        """
        for start in itertools.count(1):
            try:
                reset = self._prepare(policy, Resetting(ready, reset_body, rest_time))
                self._begin_bag(policy.id)
                executed = self._collect(policy, duration, self._execute(policy))
                return replace(executed, reset=reset)
            except NotBegunError as error:  # the trial is not counted
                self._log.warning(f"{policy.id} is started again: {error}")
                if start == STARTS_MAX:
                    raise
            except EndedByPersonError as error:
                self.awaited = _nothing
                error.bag = self._end_bag()
                raise

    def until(
        self, condition: Callable[[], object], what: str | Callable[[], str], timeout: float
    ) -> None:
        """Wait until a condition holds, see `Link.until`; a RolloutError after the timeout.

        While simulated time advances, the timeout must have passed in it, too, but `TIMEOUTS_MAX`
        of them suffice: a busy machine is not an error, but an idle simulation is slow.
        """
        clock = self._node.get_clock()
        begun = last = clock.now()
        timeouts = 0
        while not self._link.until(condition, what, timeout):
            now, timeouts = clock.now(), timeouts + 1
            advances = clock.ros_time_is_active and now > last and timeouts < TIMEOUTS_MAX
            if not advances or (now - begun).nanoseconds > timeout * 1e9:
                awaited = what() if callable(what) else what
                raise RolloutError(f"waited {timeouts * timeout:.0f} s in vain for {awaited}")
            last = now

    # Requests

    def _ask(self, action: Action, policy: Policy, timeout: float) -> tuple[Answer, Any]:
        """Outcome and result of a goal about a policy, see `_end_of`."""
        goal: dict[str, object] = {} if action is self._scene else {"known_stop": self._known()}
        goal["policy"] = PolicyMessage(id=policy.id, text=policies.to_json(policy))
        return self._end_of(action.send(**goal), policy.id, timeout)

    def _known(self) -> str:
        """Last stop after which a person has let the session go on, as a goal names it."""
        return "" if self._known_stop is None else self._known_stop or "none"

    def _end_of(self, goal: Goal, what: str, timeout: float) -> tuple[Answer, Any]:
        """Outcome and result of a goal, UNKNOWN and None if it was lost; or EndedByPersonError."""
        self.until(lambda: goal.ended, f"the end of {goal.what} of {what}", timeout)
        answer = goal.answer or NO_ANSWER
        if answer.stop:
            self.reports.last_stop = answer.stop
            raise EndedByPersonError(answer, ran=_start_ns(goal.result) > 0)
        return answer, goal.result

    def _call(self, name: str, data: bool | None = None) -> Answer:
        """Answer of a service; of code UNKNOWN if none came."""
        answer = self._link.call(name, data, ANSWER_TIMEOUT)
        if answer is None:
            self._log.warning(f"no answer from {self._node.resolve_service_name(name)}")
        return answer or NO_ANSWER

    def _begin_bag(self, policy_id: str) -> None:
        if not self._settings.record_rollouts:
            return
        answer = self._call(interface.RECORD, True)
        if not answer.success and self._end_bag():  # of a killed learner
            answer = self._call(interface.RECORD, True)
        if not answer.success:
            self._log.warning(f"{policy_id} is not recorded: {answer.message}")

    def _end_bag(self) -> str:
        """End the recording; returns the name of the bag, empty without one."""
        if not self._settings.record_rollouts:
            return ""
        answer = self._call(interface.RECORD, False)
        return FilePath(answer.text).name if answer.success else ""

    # One rollout

    def _execute(self, policy: Policy) -> ExecutePolicy.Result:
        """Execute the policy, to the end; waits without limit for the enabling switch to be held.

        A NotBegunError if the controller had a fault before, or did not answer.
        """
        end = time.monotonic() + self._settings.service_timeout
        while True:
            answer, result = self._ask(self._execution, policy, self._settings.rollout_timeout)
            if self._await_switch(answer, f"for {policy.id}"):
                continue
            if _start_ns(result):
                return result
            if answer.code in NOT_BEGUN_CODES:
                raise NotBegunError(answer.message)
            if time.monotonic() > end:
                raise RolloutError(f"{policy.id} could not be executed: {answer.message}")
            self._link.sleep(RETRY_PERIOD)

    def _await_switch(self, answer: Answer, why: str) -> bool:
        """Whether a person is to hold the enabling switch; then a moment has been waited for it."""
        if answer.code is not Code.SWITCH:
            self.awaited = _nothing
            return False
        awaited = Awaited("switch", f"the enabling switch to be held, {why}")
        self.awaited = lambda: awaited
        self._log.info(f"waiting for {awaited.what}", throttle_duration_sec=SWITCH_LOG_PERIOD)
        self._link.sleep(RETRY_PERIOD)
        return True

    def await_rating(self, rollout_id: str, rated: Callable[[], bool]) -> None:
        """Wait without limit until a person has rated a rollout; an EndedByPersonError as ever."""
        awaited = Awaited("rate", f"a rating of {rollout_id}: 0 (worst) to 9 (as it should be)")
        self._log.info(f"waiting for {awaited.what}")
        self._until(rated, lambda: awaited)

    def _until(self, condition: Callable[[], object], awaited: Callable[[], Awaited]) -> None:
        """Wait without limit until a condition holds, and say so."""
        self.awaited = awaited
        self.until(lambda: condition() or self._stopped(), lambda: awaited().what, math.inf)
        self.awaited = _nothing
        if self._stopped():
            text = f"stopped by a person in a wait for {awaited().what}"
            raise EndedByPersonError(Answer(Code.STOPPED, text))

    def _stopped(self) -> bool:
        """Whether a person has stopped the arm since the session was let go on."""
        known = self._known_stop
        return known is not None and self.reports.last_stop not in ("", known)

    def _prepare(self, policy: Policy, resetting: Resetting) -> dict[str, Any] | None:
        """Move the arm to the start of the policy, and see to it that the body is ready there.

        Waits without limit for a body that a person puts back, or that is not seen. Returns who put
        it back, in which time; None if the scene was reset, or without a body.
        """
        if self._settings.scene_reset:
            self._reset_scene(policy, resetting.ready)
            return None
        begun = self._node.get_clock().now()
        by_person = self._reach_start(policy)
        if not self._body:
            return None
        if not self._joint_names:
            resetting.reset = lambda state: "person"
        self._resetting = resetting
        while True:
            self._until(
                lambda: self._resetting.done or self._resetting.move or self.reports.fault,
                self._awaited_body,
            )
            resetting = self._resetting
            if self.reports.fault is not None:  # the arm may have left the start
                by = resetting.by
                by_person |= self._reach_start(policy)
                self._resetting = replace(resetting, by=by, move=None)
                continue
            if (move := resetting.move) is None:
                break
            self._log.info(f"the arm puts the {self._body} back: {resetting.missing}")
            self._do(move)
            self._reach_start(policy)
            resetting.move = None
        seconds = (self._node.get_clock().now() - begun).nanoseconds * 1e-9
        return {"by": "person" if by_person else resetting.by, "seconds": round(seconds, 3)}

    def _awaited_body(self) -> Awaited:
        """What the body lacks before a rollout may begin."""
        resetting, silent = self._resetting, time.monotonic() - self._seen
        if silent > SILENCE:
            what = f"the {self._body} to be seen: no state of it for {silent:.0f} s"
            return Awaited("not_visible", what)
        if resetting.waits:
            return Awaited("rest", f"the {self._body} to come to rest: {resetting.missing}")
        what = f"the {self._body} to be ready, which a person puts back: {resetting.missing}"
        return Awaited("put back" if resetting.by == "person" else "rest", what)

    def _do(self, move: Move) -> None:
        """Execute a movement that puts the body back; a refusal is logged, and a person asked."""
        message = movement_message(self._joint_names, JointMovement(move.t, move.q))
        while True:
            goal = self._replays.send(movement=message, known_stop=self._known())
            moved = f"a movement of the {self._body}"
            answer, _ = self._end_of(goal, moved, self._settings.patience)
            if not self._await_switch(answer, f"to put the {self._body} back"):
                break
        if not answer.success:
            self._log.warning(f"the {self._body} is not put back: {answer.message}")
            self._link.sleep(RETRY_PERIOD)

    def _reset_scene(self, policy: Policy, ready: Ready) -> None:
        """Let the stand-in reset the scene, again if needed, until the body is ready."""
        end = time.monotonic() + self._settings.patience
        while True:
            self._reach_start(policy)
            answer, result = self._ask(self._scene, policy, self._settings.service_timeout)
            if not answer.success:
                raise NotBegunError(f"the scene is not reset: {answer.message}")
            if not self._body:
                return
            seen_ns = nanoseconds(result.header.stamp) + LEAD_TIME  # its path begins later
            again = self._resetting = Resetting(ready, lambda state: "wait", since_ns=seen_ns)
            what = lambda again=again: f"the {self._body} to be ready: {again.missing}"  # noqa: E731
            try:
                return self.until(lambda again=again: again.done, what, READY_TIMEOUT)
            except RolloutError:
                if time.monotonic() > end:
                    raise
                self._log.warning(f"the scene is reset again: {again.missing}")

    def _reach_start(self, policy: Policy) -> bool:
        """Move the arm to the start of the policy, after a reset of a fault if needed.

        Waits without limit for a person to activate the controller, or to reset its fault. Returns
        whether one was needed.
        """
        by_person = False
        end = time.monotonic() + self._settings.patience
        while True:
            answer, _ = self._ask(self._to_start, policy, self._settings.patience)
            if answer.success:
                self.reports.fault = None
                return by_person
            resets = self._settings.reset_faults
            if answer.code is Code.NOT_ACTIVE or (answer.code is Code.FAULT and not resets):
                by_person = True
                self._await_person(answer)
                end = time.monotonic() + self._settings.patience
                continue
            if time.monotonic() > end or answer.code is Code.REFUSED:
                text = f"the arm cannot move to the start of {policy.id}: {answer.message}"
                raise RolloutError(text)
            if answer.code is Code.FAULT:
                self._call(interface.RESET)
            else:
                self._log.warning(f"the arm cannot move to its start: {answer.message}", once=True)
            self._link.sleep(BUSY_PERIOD if answer.code is Code.BUSY else RETRY_PERIOD)

    def _await_person(self, refused: Answer) -> None:
        """Wait until the diagnostics say that the controller is active, or has no fault."""
        reports, count = self.reports, self.reports.count  # the last one may be out of date
        if refused.code is Code.FAULT:
            awaited = Awaited("reset", f"a person to reset the controller: {refused.message}")
            done = lambda: reports.count > count + 1 and reports.fault is None  # noqa: E731
        else:
            reports.mode = ""
            what = "the torque controller to be active (ros2 lifecycle set)"
            awaited = Awaited("activate", what)
            done = lambda: reports.mode not in INACTIVE_MODES  # noqa: E731
        self._until(done, lambda: awaited)

    def _collect(self, policy: Policy, duration: float, result: ExecutePolicy.Result) -> Executed:
        """Wait for the messages of the rollout that has ended.

        The latched topics may have those of an earlier one; paths have the stamp of its start.
        """
        end, timeout = Ended.read(result.end), self._settings.rollout_timeout
        tool = EndEffectorPath(policy.id, *pose_messages.path(result.path)[1:])
        body = truth = None
        if self._body:
            what = f"the path of the {self._body} of {policy.id}"
            there = lambda: (it := self._body_path()) and it.start_ns == end.start_ns  # noqa: E731
            self.until(there, what, timeout)
            body = BodyPath(policy.id, *self._body_path()[1:])
        bag = self._end_bag()
        if self._node.count_publishers(self._truth_topic):

            def known() -> bool:
                it = self._truth()
                return it and it.policy_id == policy.id and it.end_ns >= end.start_ns

            try:
                self.until(known, f"the ground truth of {policy.id}", timeout)
                truth = self._truth().values
            except RolloutError as error:  # of a simulation that was restarted meanwhile
                self._log.warning(f"{policy.id} has no ground truth: {error}")
        fault = end.fault if tool.t[-1] < duration - MISSING_MAX else None
        return Executed(Rollout(tool, body, fault, end.region), bag, truth)


def _start_ns(result: Any) -> int:  # noqa: ANN401 - of any action
    """Stamp of the start of a rollout that has run [ns]; 0 for another result."""
    return Ended.read(result.end).start_ns if isinstance(result, ExecutePolicy.Result) else 0


def _nothing() -> None:
    return None
