# SPDX-License-Identifier: Apache-2.0
"""Learner: demonstrations and finished rollouts in, policies to try out; everything is logged.

`Practice` chooses the trials of a session, `Session` keeps its folder, `Rollouts` executes a trial;
this node connects them. Meanwhile a person may reward or punish the last finished rollout, add a
demonstration, or pause to record one: this is on disk before it is answered.
"""

from __future__ import annotations

import itertools
import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path as FilePath
from typing import Any

import rclpy
from pydantic import Field
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from std_srvs.srv import Trigger

from wam_power_interfaces import srv
from wam_power_ros import installed, plain_json
from wam_power_ros.arm_identity import refusal, remark
from wam_power_ros.client.link import Link
from wam_power_ros.client.rollouts import EndedByPersonError, Executed, Rollouts, RolloutSettings
from wam_power_ros.durable_files import explained
from wam_power_ros.learning.policy import Policy, with_id
from wam_power_ros.nodes.demonstrations import Demonstrations
from wam_power_ros.nodes.markers import Markers
from wam_power_ros.params.node_params import Names, Params, plain
from wam_power_ros.params.simulated_arm import SimulatedArm
from wam_power_ros.practice.new_goal import context_for, policy_for
from wam_power_ros.practice.practice import GO_ON, RATING_MAX, Practice
from wam_power_ros.practice.session import Session, read, read_policy
from wam_power_ros.practice.session_log import KIND_NAMES, Event, Pause, Record, Trial
from wam_power_ros.practice.settings import of_parameters
from wam_power_ros.ros import interface
from wam_power_ros.ros.diagnostics import LEARNER_STATE, Diagnostics
from wam_power_ros.ros.node_runner import check_arguments, end, init, interrupt_on_signals
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError, fill
from wam_power_ros.tasks.rated import assessed
from wam_power_ros.tasks.task import Assessment, Pose, Task


class LearnerParams(Params, RolloutSettings):
    """Parameters of the node; the values are in config/learner.yaml."""

    file = "learner.yaml"

    joint_names: Names  # as in the bags, from the driver
    model_joint_names: Names  # the same in the URDF
    urdf: str  # path, or a file of our share folder
    tool_frame: str
    base_frame: str
    # Parameter files of the controller, for the simulation
    controller: tuple[str, ...] = Field(min_length=1, max_length=20)
    session: str  # folder
    demonstrations: tuple[str, ...] = Field(max_length=1000)  # bags; not needed to resume
    policy: str  # file of a learnt policy to begin with, instead of their fit; empty: none
    goal: str  # other values of the goal of the session of that policy, a JSON object; empty: none
    task: str
    preset: str  # of the task; empty: its first
    learner: str  # empty: the preset's
    trials: int = Field(ge=0, le=100_000, description="a year of practice")  # 0: the preset's
    minutes: int = Field(ge=0, le=1_000_000, description="two years")  # 0: the preset's
    changes: str  # to settings of the preset, a JSON object by name
    seed: int = Field(ge=0, le=2**63 - 1, description="an integer of ROS")
    rating: float = Field(gt=0.0, le=RATING_MAX)  # size of a reward or a punishment [return]
    unusable_max: int = Field(ge=1, le=1000, description="in a row; then a person checks the arm")


CONTROLLER = "torque_controller"  # node
COMPARE_TIMEOUT = 5.0  # [s of wall time] for it to tell its parameters


class SessionFailed(RuntimeError):
    """The session cannot go on; acknowledged trials and requests are on disk."""


class Learner(Node):
    """Runs a session of one task, one rollout at a time.

    The main thread practises, that of the link serves the requests of a person; whichever uses the
    session holds the lock.
    """

    def __init__(self) -> None:
        super().__init__("learner", automatically_declare_parameters_from_overrides=True)
        self.params = LearnerParams.from_node(self)
        params, log = self.params, self.get_logger()
        model = params.urdf, params.model_joint_names, params.tool_frame
        self._arm = SimulatedArm(*model, params.controller, log.info)
        self._session: Session | None = None
        self._practice: Practice | None = None
        self._lock = threading.Lock()
        self._under_way = False
        self._awaits_rating = False
        self._rating: Assessment | None = None  # of the rollout that awaits it
        for kind, name, answer in (
            (Trigger, interface.LEARNER_REWARD, partial(self._on_reward, params.rating)),
            (Trigger, interface.LEARNER_PUNISH, partial(self._on_reward, -params.rating)),
            (srv.Pause, interface.LEARNER_PAUSE, self._on_pause),
            (srv.Rate, interface.LEARNER_RATE, self._on_rate),
            (srv.AddDemonstration, interface.ADD_DEMONSTRATION, self._on_demonstration),
        ):
            self.create_service(kind, name, answer)
        self._kind = self._task_type()
        self._demonstrations = Demonstrations(self._kind, self._arm, params.joint_names, log)
        self._link = Link(self, params.service_timeout)
        self._rollouts = Rollouts(self._link, params, self._kind.body, params.joint_names)
        self._markers = Markers(self, params.base_frame, self._arm.region)
        self._diagnostics = Diagnostics(self, "session", self._kind.body)
        self.create_timer(1.0, self._report, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _report(self) -> None:
        """Publish what the session does or waits for: a person may have to help.

        Without the lock, which a plan holds for seconds.
        """
        session, practice, level = self._session, self._practice, "ok"
        if awaited := self._rollouts.awaited():
            state, text = awaited.state, f"waits for {awaited.what}"
            level = "ok" if state == "rest" else "warn"
        elif practice is not None and practice.paused and not self._under_way:
            state, text = "paused", practice.paused
        else:
            state = text = "plans" if self._lock.locked() else "practises"
        log = () if session is None else tuple(session.log)  # grows in the main thread
        records = [line for line in log if isinstance(line, Record)]
        resets = [record.clock.get("reset") or {} for record in records]
        helped = sum(reset.get("by") == "person" for reset in resets)
        values = {LEARNER_STATE: state, "rollouts": len(records), "put back by a person": helped}
        self._diagnostics.publish(level, text, values)

    # Requests of a person

    def _on_pause(
        self, request: srv.Pause.Request, response: srv.Pause.Response
    ) -> srv.Pause.Response:
        with self._lock:
            practice, under_way = self._practice, self._under_way
            if practice is not None and request.pause != bool(practice.paused):
                note = f"paused by a person; {GO_ON}" if request.pause else "a person lets it go on"
                self._session.append(practice.pause(request.pause, note, {"at": time.time()}))
            if not request.pause:
                self._rollouts.go_on()
        text = "continues"
        if request.pause:
            text = "pauses after the trial under way" if under_way else "paused"
        answer = Answer(Code.DONE, text)
        if practice is None:
            answer = Answer(Code.REFUSED, "no session is under way")
        response.under_way = under_way
        return fill(response, answer)

    def _on_reward(
        self, amount: float, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        rate = lambda practice: practice.rate(amount, clock={"at": time.time()})  # noqa: E731
        return self._append(response, rate)

    def _on_rate(self, request: srv.Rate.Request, response: srv.Rate.Response) -> srv.Rate.Response:
        answer = Answer(Code.REFUSED, "no rollout waits for a rating")
        if self._awaits_rating:
            try:
                self._rating = assessed(request.value)
                answer = Answer(Code.DONE, f"rated {request.value:.2g}")
            except ValueError as error:
                answer = Answer(Code.REFUSED, str(error))
        return fill(response, answer)

    def _append(self, response: Any, make: Callable[[Practice], Event]) -> Any:  # noqa: ANN401
        """Append an event to the log of the session, or answer why it is not possible."""
        try:
            with self._lock:
                if self._practice is None:
                    raise ValueError("no session is under way")
                event = make(self._practice)
                self._session.append(event)
        except ValueError as error:
            self.get_logger().warning(f"request refused: {error}")
            return fill(response, Answer(Code.REFUSED, str(error)))
        self.get_logger().info(event.note)
        return fill(response, Answer(Code.DONE, event.note))

    def _on_demonstration(
        self, request: srv.AddDemonstration.Request, response: srv.AddDemonstration.Response
    ) -> srv.AddDemonstration.Response:
        bag = request.bag

        def make(practice: Practice) -> Event:
            if not bag:
                raise ValueError("the request names no bag")
            taken = [candidate.id for candidate in practice.candidates]
            numbers = itertools.count(len(taken) + 1)
            id = next(id for n in numbers if (id := f"demonstration-{n}") not in taken)
            read = self._demonstrations.read(bag)
            springs = practice.settings.practice.springs
            policy = self._demonstrations.fit(read, bag, id, springs)
            return practice.add_demonstration(policy, bag, clock={"at": time.time()})

        return self._append(response, make)

    # A session

    def practise(self) -> None:
        """Begin or resume the session of the parameters, and run it to its end.

        SessionFailed or ServiceError if it cannot go on, ValueError or OSError for its folder or a
        parameter.
        """
        with self._link:
            session, practice = self._open()
            with session:
                self._save_best(session, practice)  # a killed learner may have missed it
                with self._lock:
                    self._session, self._practice = session, practice
                self._take_up(session, practice)
                try:
                    while self._trial(session, practice):
                        pass
                finally:
                    with self._lock:
                        self._practice = None
        why = practice.best.why if practice.best else ""
        self.get_logger().info(f"session finished: {practice.stopped}. {why}")

    def _compare(self) -> None:
        """Ask the controller for its parameters: policies are planned with them."""
        known = {name: plain(value) for name, value in self._arm.parameters.items()}
        values = self._link.parameters(CONTROLLER, list(known), COMPARE_TIMEOUT)
        if not values:  # renamed, or secured
            self.get_logger().info(f"{CONTROLLER} does not tell its parameters: not compared")
        found = map(plain, map(parameter_value_to_python, values))
        pairs = zip(known.items(), found, strict=False)
        other = [f"{name} {there}, here {own}" for (name, own), there in pairs if there != own]
        if other:
            raise SessionFailed(
                f"{CONTROLLER} was started with another set-up than this node: {'; '.join(other)}. "
                "Give both the same parameter files"
            )

    def _take_up(self, session: Session, practice: Practice) -> None:
        """Pause if the arm was stopped after the last line of the session, while no learner ran.

        An older stop, such as that of teaching, was before a person started the session.
        """
        reported = lambda: self._rollouts.reports.count  # noqa: E731
        self._link.until(reported, "a report of the controller", self.params.service_timeout)
        self._compare()
        with self._lock:
            stopped = self._rollouts.go_on()
            clock = session.log[-1].clock if session.log else {"at": math.inf}  # of the last line
            written = clock.get("at", clock.get("begun", 0.0) + clock.get("took", 0.0))
            if not practice.paused and stopped > written:
                note = f"stopped by a person while no learner ran; {GO_ON}"
                session.append(practice.pause(True, note, {"at": time.time()}))
        if practice.paused:
            self.get_logger().warning(practice.paused)

    def _trial(self, session: Session, practice: Practice) -> bool:
        """Execute the next trial and learn from it; returns False if there is none."""
        if not practice.finished:
            text = lambda: f"the end of the pause ({practice.paused})"  # noqa: E731
            self._link.until(self._may_begin, text, math.inf)
        with self._lock:
            trial = practice.next_trial()
        if trial is None:
            return False
        begun, begun_monotonic = time.time(), time.monotonic()
        done = self._execute(trial, practice)
        clock = {"begun": begun, "took": time.monotonic() - begun_monotonic}
        with self._lock:
            line = _learnt(practice, trial, done, self._rating, clock)
            session.append(line)  # on disk before the next trial
            self._save_best(session, practice)
            self._under_way = False
        if isinstance(line, Record):
            ret = f"return {'-' if line.ret is None else f'{line.ret:.3f}'}"
            name = f"{line.id} {KIND_NAMES[line.kind]}"
            self.get_logger().info(f"{name}: {ret} {line.why} {line.note}".rstrip())
        if practice.paused:
            self.get_logger().warning(practice.paused)
        elif practice.unusable_in_a_row >= self.params.unusable_max:
            raise SessionFailed(
                f"{practice.unusable_in_a_row} rollouts in a row could not be learnt from, the "
                f"last one: {practice.records[-1].why}. Check arm and motion capture, then resume "
                "the session"
            )
        return True

    def _may_begin(self) -> bool:
        """Whether the next trial may begin, which then counts as under way."""
        with self._lock:
            self._under_way = not self._practice.paused
            return self._under_way

    def _save_best(self, session: Session, practice: Practice) -> None:
        if (best := practice.best) is not None:
            session.save_policy(best.policy)

    def _task_type(self) -> type[Task]:
        """Task of the session if it exists, else of the parameters."""
        folder = FilePath(self.params.session)
        own = installed.import_task(self.params.task)  # a session may be a stranger's
        begun = read(folder).header.settings.task if Session.exists(folder) else ""
        return installed.task_type(begun or own)

    def _open(self) -> tuple[Session, Practice]:
        params = self.params
        folder = FilePath(params.session)
        if Session.exists(folder):
            session = Session.open(folder)
            self._check_arm(session)
        else:
            settings = of_parameters(params.model_dump())
            named = list(filter(None, params.demonstrations))
            settings.check(1 if params.policy else len(named))  # before the bags are read
            bags, demonstrations, candidates = self._demonstrations.candidates(settings, named)
            context = self._kind.context_of(demonstrations, self._arm.region)
            if params.policy:
                carried = read_policy(FilePath(params.policy), self._arm.identity)
                if params.goal:
                    context, carried = self._for_goal(FilePath(params.policy).parent)
                candidates = [with_id(replace(carried, arm=self._arm.identity), "carried-over")]
            given = {"context": context, "demonstrations": bags}
            session = Session.begin(folder, settings, params.seed, candidates, **given)
        practice = session.practice(self._arm)
        self.get_logger().info(f"session {folder}: {len(session.records)} rollouts on record")
        return session, practice

    def _for_goal(self, origin: FilePath) -> tuple[dict[str, Any], Policy]:
        goal = plain_json.parse(self.params.goal, "goal")
        known = read(origin)
        settings, of = known.header.settings, (known.task, known.policies, known.records)
        context = context_for(settings, known.context, goal)
        policy, remark = policy_for(settings.make_task(context), *of, self._arm, "carried-over")
        self.get_logger().info(f"goal {self.params.goal}: {remark}")
        return context, policy

    def _check_arm(self, session: Session) -> None:
        """Refuse a session with policies of another arm, including demonstrations added later."""
        for policy in session.policies:
            if why := refusal(policy.arm, self._arm.identity):
                session.close()
                raise SessionFailed(f"{session.folder}: policy {policy.id} {why}")
            if note := remark(policy.arm, self._arm.identity):
                self.get_logger().info(f"{session.folder}: policy {policy.id} {note}")

    def _execute(self, trial: Trial, practice: Practice) -> Executed | EndedByPersonError:
        """Execute one trial, until its end and its rating if one is due, or a person ends it."""
        task = practice.task
        if fault := self._arm.infeasible(trial.policy):  # if begun with other limits
            raise SessionFailed(
                f"{trial.id} ({trial.purpose}) was not sent: with the present limits it would end "
                f"in a fault: {fault.text}"
            )
        arm, policy = self._arm.kinematics, trial.policy
        tool = Pose(*arm.tool_pose(policy.q_start))
        self._markers.plan(policy, tool.position)
        try:
            executed = self._rollouts.execute(
                policy,
                policy.basis.duration + task.settle_time,
                lambda state: task.ready(state, tool),
                lambda state: task.reset(state, arm, policy.q_start),
                task.rest_time,
            )
            self._rating = None
            if practice.awaits_rating(trial, executed.rollout):
                self._awaits_rating = True
                self._rollouts.await_rating(trial.id, lambda: self._rating is not None)
        except EndedByPersonError as ended:
            return ended
        finally:
            self._awaits_rating = False
        return executed


def _learnt(
    practice: Practice,
    trial: Trial,
    done: Executed | EndedByPersonError,
    rating: Assessment | None,
    clock: Mapping[str, Any],
) -> Record | Pause:
    """Learn from a trial, or pause if a person has ended it; returns the line to be logged."""
    if not isinstance(done, EndedByPersonError):
        clock = {**clock, **({} if done.reset is None else {"reset": done.reset})}
        logged: dict[str, Any] = {"bag": done.bag, "truth": done.truth, "clock": clock}
        if rating is not None:
            return practice.learn_assessed(trial, rating, **logged)
        return practice.learn(trial, done.rollout, **logged)
    if done.ran:
        return practice.refuse(trial, str(done), bag=done.bag, clock=clock)
    return practice.pause(True, f"{done}; {GO_ON}", clock)


def main() -> int:
    """Entry point of `ros2 run wam_power_ros learner`."""
    node = None
    interrupt_on_signals()
    try:
        init()
        check_arguments()
        node = Learner()
        node.practise()
    except (SessionFailed, ServiceError, ValueError, OSError) as error:
        log = node.get_logger() if node else rclpy.logging.get_logger("learner")
        text = explained(error) if isinstance(error, OSError) else str(error)
        log.fatal(text)
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        end()
    return 0
