# SPDX-License-Identifier: Apache-2.0
"""Learner: demonstrations and finished rollouts in, policies to try out; all of it logged.

The course of a session is `Practice`, its folder is `Session`; what is here is the conversation:
publish the policy, bring the arm to its start, see the pancake rest in the pan, execute, take the
two paths, make the record durable, go on. Meanwhile a person may reward or punish the last finished
rollout, give a further demonstration, or have it wait to record one: on disk before it is answered.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path as FilePath
from typing import Any, Literal, TypeVar

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry, Path
from pydantic import Field
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.bags.reader import read_demonstration
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.feasibility import simulate_policy
from wam_power_ros.control.modes import Mode
from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.demonstration import from_joint_samples
from wam_power_ros.learning.dmp import PANCAKE, fit
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Fault, FaultKind
from wam_power_ros.params.node_params import Params
from wam_power_ros.params.resources import share
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.practice.practice import RATING_MAX, Practice, reproduced
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.session_log import Event, Record
from wam_power_ros.practice.settings import PracticeSettings, preset
from wam_power_ros.practice.trial import Trial
from wam_power_ros.ros import interface, pose_messages
from wam_power_ros.ros.answers import Answer, Code, read
from wam_power_ros.ros.node_runner import executor_for, number_by_process
from wam_power_ros.ros.service_client import DISCOVERY

T = TypeVar("T")
STARTS = 5  # of a trial, when faults come before its rollout
ANSWER = 10.0  # one that has not come by then is taken for lost [s of wall time]
TELLING = 5.0  # what is waited for for so long is told [s of wall time]
CLOCKS_APART = 0.2  # most that arm and motion capture may be [s]; the tracker scores no more
FAULT_PATIENCE = 2.5  # for the diagnostics that name a fault, which come once a second [s]
MOVING = Mode.MOVE_TO_START.value
CONTROLLER = "torque_controller"  # name of the node whose diagnostics tell of faults


class LearnerParams(Params):
    """Parameters of the node; the values are in config/learner.yaml."""

    joint_names: tuple[str, ...]  # as the driver has them in the bags
    model_joint_names: tuple[str, ...]  # the same in the URDF
    urdf: str  # path, or a file of our share folder
    tool_frame: str
    body: str  # name of the tracked body
    controller: tuple[str, ...] = Field(min_length=1)  # its parameters, to rehearse with: files
    session: str  # folder; empty: none is begun
    demonstrations: tuple[str, ...]  # bags; not needed to resume
    preset: Literal["flip", "paper"]
    trials: int = Field(ge=0)  # budget; 0: the preset's
    seed: int = Field(ge=0)
    pancake_reset: bool  # a service puts the pancake back; otherwise a person does
    reset_faults: bool  # stand-in only: in the lab a person resets the controller
    record_rollouts: bool
    service_timeout: float = Field(gt=0.0)  # [s of wall time]
    rollout_timeout: float = Field(gt=0.0)  # [s of wall time]
    patience: float = Field(gt=0.0)  # for the pancake to rest in the pan [s of wall time]
    rating: float = Field(gt=0.0, le=RATING_MAX)  # of a reward or a punishment [return]
    unusable_max: int = Field(ge=1)  # rollouts in a row that could not be learnt from


class Trouble(RuntimeError):
    """The session cannot go on; what was acknowledged is on disk."""


class NotBegun(Trouble):
    """The rollout has not begun, as far as is known: a fault came first, or no answer."""


class Learner(Node):
    """Practises one skill, one rollout at a time."""

    def __init__(self) -> None:
        super().__init__("learner", automatically_declare_parameters_from_overrides=True)
        self.params = LearnerParams.of(self)
        params = self.params
        if len(params.model_joint_names) != len(params.joint_names):
            raise ValueError(
                f"model_joint_names {params.model_joint_names} must be as many as joint_names"
            )
        urdf = share(params.urdf).read_text()
        self._arm = Arm(urdf, params.model_joint_names, params.tool_frame)
        own, *over = (share(file) for file in params.controller)
        as_set = TorqueControllerParams.of_file(own, "torque_controller", *over)
        self._rehearsed = as_set.controller(urdf)
        self._verdicts: dict[str, str] = {}  # movement -> the fault its rehearsal ended in
        self._policy_pub = self.create_publisher(String, interface.POLICY, interface.LATCHED)
        self._pan: tuple[int, EndEffectorPath] | None = None
        self._pancake: tuple[int, BodyPath] | None = None
        self._truth: dict[str, Any] | None = None
        self._fault: Fault | None = None
        self._mode = ""  # of the controller, as told once a second
        self._resting = 0  # frames in a row
        self._rested_ns = 0  # stamp of the last of them
        self._pan_at_start = (np.zeros(3), np.eye(3))
        self._session: Session | None = None
        self._practice: Practice | None = None
        self._paused = False
        self._bag = ""  # that was named last
        self._truth_topic = interface.body_topic(params.body, "truth")
        self._reset_service = interface.body_topic(params.body, "reset")
        subscribe = self.create_subscription
        subscribe(Path, interface.ROLLOUT_END_EFFECTOR, self._on_end_effector, interface.LATCHED)
        subscribe(Path, interface.rollout_topic(params.body), self._on_pancake, interface.LATCHED)
        subscribe(
            Odometry,
            interface.body_topic(params.body, "state"),
            self._on_state,
            interface.STATE_OUT,
        )
        subscribe(String, self._truth_topic, self._on_truth, interface.LATCHED)
        subscribe(
            DiagnosticArray, interface.DIAGNOSTICS, self._on_diagnostics, interface.DIAGNOSTICS_QOS
        )
        subscribe(String, interface.LEARNER_BAG, self._on_bag, interface.LATCHED)
        rating = params.rating
        for kind, name, answer in (
            (Trigger, interface.LEARNER_REWARD, self._answer(lambda: self._rate(rating))),
            (Trigger, interface.LEARNER_PUNISH, self._answer(lambda: self._rate(-rating))),
            (Trigger, interface.LEARNER_DEMONSTRATION, self._answer(self._give)),
            (SetBool, interface.LEARNER_PAUSE, self._on_pause),
        ):
            self.create_service(kind, name, answer)
        self._offers = {
            name: self.create_client(Trigger, name)
            for name in (
                interface.MOVE_TO_START,
                interface.EXECUTE,
                self._reset_service,
                interface.RESET,
            )
        }
        self._offers[interface.RECORD] = self.create_client(SetBool, interface.RECORD)
        self._asked: set[str] = set()  # of these services
        self._executor = executor_for(self)

    # Messages in

    def _on_end_effector(self, message: Path) -> None:
        self._pan = self._read(lambda: pose_messages.path(message, EndEffectorPath))

    def _on_pancake(self, message: Path) -> None:
        self._pancake = self._read(lambda: pose_messages.path(message, BodyPath))

    def _on_state(self, message: Odometry) -> None:
        state = self._read(lambda: pose_messages.odometry(message))
        if state is None:
            return
        position, rotation = self._pan_at_start
        offset = rotation.T @ (state.position - position)  # in the pan, which may be tilted
        at_rest = (
            np.hypot(offset[0], offset[1]) < 0.10
            and -0.01 < offset[2] < 0.03
            and np.linalg.norm(state.velocity) < 0.05
        )
        self._resting = self._resting + 1 if at_rest else 0
        self._rested_ns = state.stamp_ns

    def _on_truth(self, message: String) -> None:
        self._truth = self._read(lambda: json.loads(message.data))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.startswith(CONTROLLER):
                at_fault = status.level == DiagnosticStatus.ERROR
                values = {each.key: each.value for each in status.values}
                kind = values.get("fault kind", "")
                known = at_fault and kind in [each.value for each in FaultKind]
                self._fault = Fault(FaultKind(kind), status.message) if known else None
                self._mode = values.get("mode", "")

    def _read(self, convert: Callable[[], T]) -> T | None:
        try:
            return convert()
        except ValueError as error:
            self.get_logger().warning(f"message ignored: {error}", throttle_duration_sec=1.0)
            return None

    # What a person may do meanwhile

    def _on_bag(self, message: String) -> None:
        self._bag = message.data

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._paused = request.data
        response.success = True
        response.message = "waits after the trial under way" if request.data else "goes on"
        return response

    def _answer(
        self, take_up: Callable[[], Event]
    ) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        """A service that makes what `take_up` gives durable, or answers why there is nothing."""

        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                event = take_up()
            except ValueError as error:
                response.message = str(error)
                self.get_logger().warning(f"refused: {error}")
                return response
            self._session.append(event)
            self.get_logger().info(event.note)
            response.success, response.message = True, event.note
            return response

        return answer

    def _rate(self, amount: float) -> Event:
        return self._under_way().rate(amount, clock={"at": time.time()})

    def _give(self) -> Event:
        practice, bag, self._bag = self._under_way(), self._bag, ""
        if not bag:
            raise ValueError(interface.NO_BAG)
        taken = [candidate.id for candidate in practice.candidates]
        number = len(taken) + 1
        while f"demonstration-{number}" in taken:
            number += 1
        policy = self._fit(bag, f"demonstration-{number}")
        return practice.give(policy, bag, clock={"at": time.time()})

    def _under_way(self) -> Practice:
        if self._practice is None:
            raise ValueError("no session is under way")
        return self._practice

    # Waiting

    def _until(self, condition: Callable[[], object], what: str, timeout: float) -> None:
        if not self._comes(condition, what, timeout):
            raise Trouble(f"not within {timeout:.0f} s: {what}")

    def _comes(self, condition: Callable[[], object], what: str, timeout: float) -> bool:
        """Whether it comes true in time; what is waited for is told."""
        begun, told = time.monotonic(), False
        while not condition():
            if not rclpy.ok():
                raise ExternalShutdownException
            waited = time.monotonic() - begun
            if waited > timeout:
                return False
            if waited > TELLING and not told:
                self.get_logger().info(f"waiting: {what}")
                told = True
            self._executor.spin_once(timeout_sec=0.05)
        return True

    def _call(self, name: str) -> Answer | None:
        return self._ask(name, Trigger.Request())

    def _ask(self, name: str, request: object) -> Answer | None:
        """Answer of a service, None if none has come.

        Questions and answers can be lost: the middleware drops an answer to a client that it has
        not discovered, and a node may be started again. So nothing waits long for one.
        """
        client = self._offers[name]
        timeout = self.params.service_timeout
        self._until(client.service_is_ready, f"service {name} is offered", timeout)
        if name not in self._asked:  # or a learner that has just started waits for a lost answer
            self._asked.add(name)
            self._comes(lambda: False, f"{name} sees us", DISCOVERY)
        future = client.call_async(request)
        late = time.monotonic() + ANSWER
        self._comes(
            lambda: future.done() or (time.monotonic() > late and self._mode != MOVING),
            f"answer of {name}",
            self.params.patience,
        )
        if not future.done():
            client.remove_pending_request(future)
            self.get_logger().warning(f"{name} does not answer")
            return None
        response = future.result()
        return read(response.success, response.message)

    # A session

    def practise(self) -> None:
        """Run the session of the parameters to its end, or take it up where it was left."""
        session, practice = self._open()
        log = self.get_logger()
        with session:
            self._session, self._practice = session, practice
            self._keep_best(session, practice)  # this may be where the last learner was killed
            while True:
                self._until(lambda: not self._paused, "the pause is over", math.inf)
                if (trial := practice.next_trial()) is None:
                    break
                begun = time.time()
                record = self._perform(practice, trial, begun)
                session.append(record)  # on disk before anything else is tried
                self._keep_best(session, practice)
                log.info(f"{_line(record)} {record.note}")
                if practice.unusable_in_a_row >= self.params.unusable_max:
                    raise Trouble(
                        f"{practice.unusable_in_a_row} rollouts in a row could not be learnt "
                        f"from, the last one: {record.why}"
                    )
        best = practice.best
        log.info(f"session finished: {practice.stopped}. {'' if best is None else best.why}")

    def _keep_best(self, session: Session, practice: Practice) -> None:
        if (best := practice.best) is not None:
            session.save_policy(best.policy)

    def _open(self) -> tuple[Session, Practice]:
        params = self.params
        folder = FilePath(params.session)
        if Session.exists(folder):
            session = Session.open(folder)
        else:
            settings = preset(params.preset, **({"budget": params.trials} if params.trials else {}))
            bags, candidates = self._fit_all(settings)
            session = Session.begin(folder, settings, params.seed, candidates, demonstrations=bags)
        practice = Practice.from_records(
            session.candidates, session.settings, session.seed, session.log, self._forbidden
        )
        self.get_logger().info(f"session {folder}: {len(session.records)} rollouts on record")
        return session, practice

    def _forbidden(self, policy: policies.Policy) -> str:
        """Why the arm must not try a policy: the fault in which its rehearsal ends."""
        movement = policies.to_json(policies.with_id(policy, "movement"))
        if movement not in self._verdicts:
            simulated = simulate_policy(self._rehearsed.arm, self._rehearsed.settings, policy)
            self.get_logger().info(f"{policy.id} simulated: {simulated}")
            self._verdicts[movement] = "" if simulated.fault is None else simulated.fault.text
        return self._verdicts[movement]

    def _fit_all(self, settings: PracticeSettings) -> tuple[list[str], list[policies.Policy]]:
        """The demonstrations of which something can be made, and what."""
        bags = list(filter(None, self.params.demonstrations))
        if not bags:
            raise Trouble("a new session needs demonstrations: name at least one bag")
        candidates, refused = {}, []
        for number, bag in enumerate(bags, start=1):
            try:
                candidate = self._fit(bag, f"demonstration-{number}")
                if why := self._forbidden(reproduced(candidate, settings)):
                    raise ValueError(f"{bag}: would end in a fault: {why}")
                candidates[bag] = candidate
            except ValueError as error:
                refused.append(str(error))
                self.get_logger().warning(f"demonstration {number} is left out: {error}")
        if not candidates:
            raise Trouble(
                f"nothing can be learnt from any of {len(bags)} demonstrations "
                f"({'; '.join(refused)}). Teach others in a new session, or name other bags: "
                "wam-power learn --session ... --bags ..."
            )
        return list(candidates), list(candidates.values())

    def _fit(self, bag: str, id: str) -> policies.Policy:
        """Policy of a demonstration; ValueError names the bag and says why there is none."""
        try:
            stamps_ns, q = read_demonstration(FilePath(bag), self.params.joint_names)
            demonstration = from_joint_samples(self._arm, stamps_ns, q, trim=True)
            return fit([demonstration], PANCAKE, id)
        except (ValueError, OSError) as error:
            raise ValueError(f"{bag}: {str(error).removeprefix(f'{bag}: ')}") from error

    def _perform(self, practice: Practice, trial: Trial, begun: float) -> Record:
        """Execute one trial and learn from it, whatever comes of it."""
        if why := self._forbidden(trial.policy):  # a session of other limits goes on here
            raise Trouble(
                f"{trial.id} ({trial.why}) was not sent: by these limits it would end in a "
                f"fault: {why}"
            )
        self._pan_at_start = self._arm.tool_pose(trial.policy.q_start)
        for attempt in range(STARTS):
            try:
                rested_ns = self._start(trial)
                break
            except NotBegun as why:  # nothing was tried, or is not counted: no trial is spent
                self.get_logger().warning(f"{trial.id} from its start again: {why}")
                if attempt == STARTS - 1:
                    raise
        pan, pancake = self._paths_of(trial, rested_ns)
        bag = self._end_bag() if self.params.record_rollouts else ""
        if self.count_publishers(self._truth_topic):
            timeout = self.params.rollout_timeout
            self._until(lambda: self._truth_of(trial), f"truth of {trial.id}", timeout)
        whole = trial.policy.basis.duration + practice.settings.settle_time
        fault = self._fault_of(pan, whole)
        return practice.learn(
            trial,
            pan,
            pancake,
            fault=fault,
            bag=bag,
            truth=self._truth_of(trial),
            clock={"begun": begun, "took": time.time() - begun},
        )

    def _start(self, trial: Trial) -> int:
        """Begin the rollout of a trial; returns the stamp at which the pancake rested before [ns].

        Raises:
            NotBegun: The controller came to a fault before, or nothing was answered.
        """
        self._resting = 0
        self._reach_start(trial)
        if self.params.pancake_reset:
            self._insist(self._reset_service, trial)
        self._resting = 0
        self._until(
            lambda: self._resting >= 3, "the pancake rests in the pan", self.params.patience
        )
        rested_ns = self._rested_ns
        if self.params.record_rollouts:
            self._begin_bag(trial)
        self._truth = None
        self._fault = None
        self._insist(interface.EXECUTE, trial)
        return rested_ns

    def _paths_of(self, trial: Trial, rested_ns: int) -> tuple[EndEffectorPath, BodyPath]:
        """The two paths of the rollout that began after the pancake rested.

        A rollout of the same trial whose learner was killed has left its paths on the latched
        topics: they began earlier.
        """
        earliest_ns = rested_ns - round(CLOCKS_APART * 1e9)
        timeout = self.params.rollout_timeout
        self._until(
            lambda: _is_of(self._pan, trial) and self._pan[0] > earliest_ns,
            f"path of {trial.id}",
            timeout,
        )
        start_ns, pan = self._pan
        self._until(
            lambda: _is_of(self._pancake, trial) and self._pancake[0] == start_ns,
            f"pancake of {trial.id}",
            timeout,
        )
        return pan, self._pancake[1]

    def _begin_bag(self, trial: Trial) -> None:
        begun = self._ask(interface.RECORD, SetBool.Request(data=True))
        if not _agreed(begun) and self._end_bag():  # left open by a learner that was killed
            begun = self._ask(interface.RECORD, SetBool.Request(data=True))
        if not _agreed(begun):
            self.get_logger().warning(f"{trial.id} is not recorded: {_text(begun)}")

    def _end_bag(self) -> str:
        """Name of the bag that was being recorded, or nothing."""
        ended = self._ask(interface.RECORD, SetBool.Request(data=False))
        return FilePath(ended.text).name if _agreed(ended) else ""

    def _fault_of(self, pan: EndEffectorPath, whole: float) -> Fault | None:
        """The controller's fault when it cut the rollout short, as its diagnostics tell it."""
        if pan.t[-1] > whole - 0.05:
            return None
        end = time.monotonic() + FAULT_PATIENCE
        while not self._fault and time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.05)
        return self._fault

    def _truth_of(self, trial: Trial) -> dict[str, Any] | None:
        truth = self._truth
        return truth if truth is not None and truth.get("id") == trial.id else None

    def _reach_start(self, trial: Trial) -> None:
        """Bring the arm to the start of the policy, out of a fault if need be."""
        end = time.monotonic() + self.params.patience
        while True:  # the policy each time: during a rollout, a killed learner's, it is refused
            self._policy_pub.publish(String(data=policies.to_json(trial.policy)))
            answer = self._call(interface.MOVE_TO_START)
            if _is_done(answer, trial):
                return
            if time.monotonic() > end:
                raise Trouble(f"{interface.MOVE_TO_START} refused: {_text(answer)}")
            if answer is not None and answer.code is Code.FAULT and self.params.reset_faults:
                self._call(interface.RESET)
            else:
                why = _text(answer)
                self.get_logger().warning(f"the arm is not at its start: {why}", once=True)
            self._executor.spin_once(timeout_sec=0.1)

    def _insist(self, name: str, trial: Trial) -> None:
        """Call a service until it has done it for this trial.

        Topics and services are not ordered: it may be asked before the policy has come, and then
        refuses, or answers with the id of the last one.
        """
        end = time.monotonic() + self.params.service_timeout
        while True:
            answer = self._call(name)
            if _is_done(answer, trial):
                return
            # No answer: it may have begun: from the start again, rather than twice.
            if answer is None or answer.code is Code.FAULT:
                raise NotBegun(f"{name}: {_text(answer)}")
            if answer.code is Code.NOT_AT_START and answer.values.get("policy") == trial.id:
                raise NotBegun(f"{name}: {answer.text}")  # a request whose answer was lost moved it
            if time.monotonic() > end:
                raise Trouble(f"{name} for {trial.id} refused: {_text(answer)}")
            self._executor.spin_once(timeout_sec=0.05)


def _is_of(arrived: tuple[int, Any] | None, trial: Trial) -> bool:
    return arrived is not None and arrived[1].id == trial.id


def _agreed(answer: Answer | None) -> bool:
    return answer is not None and answer.success


def _is_done(answer: Answer | None, trial: Trial) -> bool:
    """Whether the request was done for this trial."""
    return _agreed(answer) and answer.values.get("policy", answer.text) == trial.id


def _text(answer: Answer | None) -> str:
    return "no answer" if answer is None else answer.text


def _line(record: Record) -> str:
    ret = "-" if record.ret is None else f"{record.ret:.3f}"
    return f"{record.id} {record.kind}: return {ret} {record.why}"


def main() -> int:
    """Entry point of `ros2 run wam_power_ros learner`."""
    rclpy.init()
    node = None
    try:
        with number_by_process():
            node = Learner()
        node.practise()
    except (Trouble, ValueError, OSError) as error:
        (node.get_logger() if node else rclpy.logging.get_logger("learner")).fatal(str(error))
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
