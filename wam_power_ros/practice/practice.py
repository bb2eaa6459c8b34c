# SPDX-License-Identifier: Apache-2.0
"""Course of a session: selection of the next policy and use of each finished rollout.

A session reproduces every demonstration once on the arm, chooses one of them by its reproduction,
explores, periodically runs the mean, stops by a rule, and re-tests its answer. Meanwhile a person
may rate rollouts and add demonstrations. The state of a `Practice` is a function of its arguments
and its log, and every line of the log, live or replayed, goes through `Practice.apply`; so
replaying a log rebuilds the practice bit for bit. No ROS, no files, no clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from wam_power_ros.learning.learner import Learner, generator_state
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy, check_id
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.practice.best_policy import Best
from wam_power_ros.practice.course import Course, reproduction_of
from wam_power_ros.practice.feedback import make_demonstration, make_rating
from wam_power_ros.practice.improvement import ArmModel, feasibility
from wam_power_ros.practice.session_log import (
    Event,
    Line,
    NewDemonstration,
    Rating,
    Record,
    plain,
)
from wam_power_ros.practice.settings import SessionSettings
from wam_power_ros.practice.trial import Trial, check_record
from wam_power_ros.tasks.task import Assessment

L = TypeVar("L", bound=Line)


class Practice:
    """A session from its first reproduction to its last re-test.

    Call `next_trial`, execute the trial, call `learn` with its rollout, write the record to disk,
    and repeat until `next_trial` returns None. `Course` has the rules for the next trial. While
    learning:

    * A person may add to the return of any usable rollout (`rate`): the learner is rebuilt from
      all rollouts, with `Record.rated_return`. A punished rollout is no success.
    * A person may add a demonstration (`add_demonstration`), which is reproduced next. If its
      return exceeds the mean of the last five rollouts, learning restarts from it with the rest
      of the budget; otherwise learning continues unchanged. The two are not mixed: a weighted mean
      of different demonstrations smooths out the peaks of acceleration that make a toss
      ([Kormushev2010], Sec. IV).
    * Ratings and demonstrations take effect on the next trial, not on the one being executed.
    """

    def __init__(
        self,
        settings: SessionSettings,
        context: Mapping[str, Any],
        candidates: Sequence[Policy],
        seed: int,
        arm: ArmModel,
        log: Sequence[Line] = (),
    ) -> None:
        """Begin a session, or resume it after the last line of `log`.

        Args:
            settings: Settings of the session.
            context: Data of the demonstrations that the task needs, see `Task.context_of`.
            candidates: Policies fitted to the demonstrations, with distinct ids.
            seed: Seed of the exploration, >= 0.
            arm: Model of the arm. These candidates are not simulated: the caller checks
                `reproduction_of` each.
            log: Lines of the log, oldest first.

        Raises:
            ValueError: `check_candidates` refuses the candidates, or the log is of another
                session; names the first line that differs.
        """
        self.settings = settings
        self.task = settings.make_task(context)
        self._arm = arm
        self._rng = np.random.Generator(np.random.PCG64(seed))
        self._course = Course(candidates, settings, self.task, self._rng, arm)
        self._records: list[Record] = []
        self._log: list[Line] = []
        self._waiting: list[Event] = []  # take effect after the pending trial
        self._pending: Trial | None = None
        for line in log:
            self.apply(line)

    @property
    def log(self) -> tuple[Line, ...]:
        """All log lines so far, oldest first."""
        return tuple(self._log)

    @property
    def records(self) -> tuple[Record, ...]:
        """All rollouts so far, oldest first, with the ratings that have taken effect."""
        return tuple(self._records)

    @property
    def candidates(self) -> tuple[Policy, ...]:
        """Policies of all demonstrations, including those added later."""
        waiting = [e.candidate() for e in self._waiting if isinstance(e, NewDemonstration)]
        return (*self._course.candidates, *waiting)

    @property
    def parametrization(self) -> Parametrization | None:
        """Parametrization of the chosen demonstration, None before the choice."""
        improvement = self._course.improvement
        return None if improvement is None else improvement.parametrization

    @property
    def learner(self) -> Learner | None:
        """The learner, None before the choice; read-only for callers."""
        improvement = self._course.improvement
        return None if improvement is None else improvement.learner

    @property
    def choice(self) -> str:
        """Current demonstration and the reason for its choice, empty before the choice."""
        return self._course.choice

    @property
    def used(self) -> int:
        """Number of rollouts used of the budget."""
        return self._course.used

    @property
    def unusable_in_a_row(self) -> int:
        """Number of latest rollouts without a return."""
        count = 0
        for record in reversed(self._records):
            if record.ret is not None:
                break
            count += 1
        return count

    @property
    def stopped(self) -> str:
        """Reason why learning stopped, empty while learning; re-tests may be outstanding."""
        return self._course.stopped

    @property
    def finished(self) -> bool:
        """Whether no rollout is left to execute."""
        return self._pending is None and self._course.finished

    @property
    def best(self) -> Best | None:
        """Best policy so far, see `choose_best`."""
        return self._course.best(self._records)

    def next_trial(self) -> Trial | None:
        """Trial to execute now, the same until it is recorded; None when finished."""
        return self._next_trial(None)

    def learn(
        self,
        trial: Trial,
        rollout: Rollout,
        *,
        bag: str = "",
        truth: Mapping[str, Any] | None = None,
        clock: Mapping[str, Any] | None = None,
    ) -> Record:
        """Assess the executed trial and learn from it.

        Args:
            trial: Trial that `next_trial` returned.
            rollout: Its rollout.
            bag: Name of the rollout's bag.
            truth: Ground truth of the simulator, logged only.
            clock: Wall-clock figures, logged only.

        Returns:
            The record, to be appended to the log before the next trial.

        Raises:
            ValueError: This is not the trial that is due, or a path is of another rollout.
        """
        if rollout.tool.id != trial.id:
            raise ValueError(f"paths are of rollout {rollout.tool.id!r}, expected {trial.id!r}")
        assessment = self.task.assess(trial.policy, rollout)
        fault = "" if rollout.fault is None else rollout.fault.text
        return self.learn_assessed(
            trial, assessment, fault=fault, bag=bag, truth=truth, clock=clock
        )

    def learn_assessed(
        self,
        trial: Trial,
        assessment: Assessment,
        *,
        fault: str = "",
        bag: str = "",
        truth: Mapping[str, Any] | None = None,
        clock: Mapping[str, Any] | None = None,
    ) -> Record:
        """Learn from a rollout that the caller has assessed; otherwise like `learn`.

        Raises:
            ValueError: This is not the trial that is due, or the return is negative or not finite.
        """
        due = self._pending
        if due is None or trial.id != due.id:
            expected = None if due is None else due.id
            raise ValueError(f"rollout {trial.id!r} is not the one that is due ({expected})")
        learnt = assessment.ret is not None and due.kind != "retest"
        why = assessment.why
        if due.kind == "retest" and not why:
            why = "a re-test is not learnt from"
        return self.apply(
            Record(
                number=due.number,
                id=due.id,
                kind=due.kind,
                demonstration=due.demonstration,
                attempt=due.attempt,
                rejections=due.rejections,
                z=due.z.tolist(),
                theta=due.theta.tolist(),
                learnt=learnt,
                learnt_as=self._in_hindsight(due, assessment).tolist() if learnt else None,
                ret=None if assessment.ret is None else float(assessment.ret),
                terms=plain(assessment.terms),
                success=bool(assessment.success),
                why=why,
                note="",
                observation=plain(assessment.observation),
                fault=fault,
                generator=generator_state(self._rng),
                bag=bag,
                truth=plain(truth),
                clock=plain(clock or {}),
            )
        )

    def rate(
        self, amount: float, number: int | None = None, clock: Mapping[str, Any] | None = None
    ) -> Rating:
        """Add a person's rating to the return of a rollout; see `make_rating`.

        Returns:
            The line, to be appended to the log before any other.

        Raises:
            ValueError: `make_rating` refuses the rating, or learning has stopped.
        """
        self._check_still_learning()
        return self.apply(
            make_rating(self._records, self._waiting, self._effective, amount, number, clock)
        )

    def add_demonstration(
        self, policy: Policy, bag: str = "", clock: Mapping[str, Any] | None = None
    ) -> NewDemonstration:
        """Add a further demonstration: its policy is reproduced next.

        Args:
            policy: Policy fitted to the demonstration, with an id not in use.
            bag: Bag of the demonstration, logged only.
            clock: Wall-clock figures, logged only.

        Returns:
            The line, to be appended to the log before any other.

        Raises:
            ValueError: The id is in use, the policy does not have the learnt parameters, it is
                infeasible, or learning has stopped.
        """
        self._check_still_learning()
        check_id(policy.id)
        if policy.id in [candidate.id for candidate in self.candidates]:
            raise ValueError(f"there is a demonstration {policy.id!r} already")
        if fault := self._arm.infeasible(reproduction_of(policy, self.task)):
            raise ValueError(f"{policy.id} is infeasible: {fault.text}")
        return self.apply(make_demonstration(policy, self._effective, bag, clock))

    def apply(self, line: L) -> L:
        """Process a log line, new or replayed.

        The figures of a replayed record are used as logged, so a session resumes exactly even on a
        processor that would round the last digit differently.

        Returns:
            The line to be logged.

        Raises:
            ValueError: The line is not the next one of this session.
        """
        if isinstance(line, Record):
            self._check_is_due(line)
            self._pending = None
            self._records.append(line)
            note = self._course.advance(self._records)
            line = line if line.note else line.model_copy(update={"note": note})
            self._records[-1] = line
            self._log.append(line)
            waiting, self._waiting = self._waiting, []
            for event in waiting:
                self._take_effect(event)
            return line
        if line.after not in (len(self._records), len(self._records) + 1):
            raise ValueError(
                f"a line after record {len(self._records)} cannot take effect "
                f"after record {line.after}"
            )
        if isinstance(line, Rating) and line.rollout > len(self._records):
            raise ValueError(f"rollout {line.rollout} was rated before it was recorded")
        self._log.append(line)
        if line.after == len(self._records):
            self._take_effect(line)
        else:
            self._waiting.append(line)
        return line

    def _next_trial(self, rejections: int | None) -> Trial | None:
        """The next trial; `rejections` is given in a replay."""
        if self._pending is None and not self.finished:
            draw = self._course.draw(self._records, rejections)
            number = len(self._records) + 1
            trial_id = f"trial-{number:04d}"
            parametrization = self._course.parametrizations[draw.demonstration]
            policy, z = parametrization.policy(draw.z, trial_id)
            theta = parametrization.theta(z)
            z.setflags(write=False)
            theta.setflags(write=False)
            self._pending = Trial(
                **{**vars(draw), "z": z}, number=number, id=trial_id, policy=policy, theta=theta
            )
        return self._pending

    def _in_hindsight(self, trial: Trial, assessment: Assessment) -> np.ndarray:
        """Coordinates at which a rollout is learnt from: corrected as far as it stays feasible."""
        parametrization = self._course.parametrizations[trial.demonstration]
        is_feasible = feasibility(parametrization, self._arm, self._records, "corrected")
        z = trial.z
        parts = self.task.hindsight(assessment, parametrization)
        if not parts or is_feasible(z + sum(parts)):
            return z + sum(parts)
        for part in parts:  # one at a time: an infeasible part does not prevent the others
            shares = (share for share in (1.0, 0.5, 0.25) if is_feasible(z + share * part))
            z = z + next(shares, 0.0) * part
        return z

    def _check_is_due(self, record: Record) -> None:
        """Raise ValueError if a record is not of the trial that is due."""
        trial = self._next_trial(record.rejections)
        if trial is None:
            raise ValueError(f"record {record.number} ({record.id}) comes after the session's end")
        check_record(trial, record, generator_state(self._rng))

    @property
    def _effective(self) -> int:
        """Number of rollouts after which a new line takes effect."""
        return len(self._records) + (self._pending is not None)

    def _check_still_learning(self) -> None:
        if self.stopped:
            raise ValueError(f"the session has stopped learning: {self.stopped}")

    def _take_effect(self, event: Event) -> None:
        if self.stopped:  # by the rollout during which the event arrived
            return
        if isinstance(event, NewDemonstration):
            self._course.add_candidate(event.candidate())
            return
        record = self._records[event.rollout - 1].with_rating(event.amount)
        self._records[event.rollout - 1] = record
        self._course.apply_rating(record, self._records)
