# SPDX-License-Identifier: Apache-2.0
"""Course of a session: selection of the next policy and use of each finished rollout.

A session reproduces every demonstration once on the arm, chooses one of them by its reproduction,
explores, periodically runs the mean, stops by a rule, and re-tests its answer. Meanwhile a person
may rate rollouts and add demonstrations. The state of a `Practice` is a fold over its log: every
line, live or replayed, goes through `Practice.apply`, so replaying a log rebuilds the practice bit
for bit. No ROS, no files, no clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import takewhile
from typing import Any, TypeVar

import numpy as np

from wam_power_ros import plain_json
from wam_power_ros.faults import FaultKind
from wam_power_ros.learning.learner import Learner, generator_state
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy, check_id, to_json
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.practice import session_log
from wam_power_ros.practice.best_policy import Best, choose_best, choose_demonstration, limit_stops
from wam_power_ros.practice.learning_run import ArmModel, LearningRun, feasibility
from wam_power_ros.practice.session_log import Line, NewDemonstration, Pause, Rating, Record, Trial
from wam_power_ros.practice.settings import PracticeSettings, SessionSettings
from wam_power_ros.tasks.task import Assessment, Task, cut_short

COMPARED_ROLLOUTS = 5  # latest ones, whose mean return a demonstration added later must exceed
RATING_MAX = 1.0  # magnitude of one rating; returns are of this order
GO_ON = "Continue goes on"
NONE_LEFT = "no policy is left that no person has refused"

L = TypeVar("L", bound=Line)
R = TypeVar("R", bound=Record)


def reproduction_of(candidate: Policy, task: Task) -> Policy:
    """Policy that reproduces a demonstration: the candidate at z = 0 of its parametrization."""
    parametrization = task.parametrization(candidate)
    return parametrization.policy(np.zeros(parametrization.size), candidate.id)[0]


def check_candidates(candidates: Sequence[Policy], settings: PracticeSettings) -> None:
    """Check the candidates of a new session.

    Raises:
        ValueError: There are no candidates, two have the same id, or the budget leaves no rollout
            to practise.
    """
    ids = [policy.id for policy in candidates]
    if not ids:
        raise ValueError("candidates is empty: a session needs at least one demonstration")
    if len(set(ids)) != len(ids):
        raise ValueError(f"candidates must have different ids, got {ids}")
    settings.check_budget(len(ids))


class Practice:
    """A session from its first reproduction to its last re-test.

    Call `next_trial`, execute the trial, call `learn` with its rollout, write the record to disk,
    and repeat until `next_trial` returns None. The lines that `learn`, `refuse`, `rate`,
    `add_demonstration` and `pause` return are to be appended to the log before any other; their
    `clock` is wall-clock figures, logged only, but for `took` [s], which counts towards `minutes`.

    The rules, whose reasons docs/method.md gives:

    * Each candidate is reproduced once; `choose_demonstration` chooses one; its reproduction is the
      learner's first rollout, at z = 0. If it succeeded, the mean is run next.
    * A rollout without a return is not learnt from; the same z is executed again, up to `attempts`
      times, then dropped. So a transient failure does not change the course of learning.
    * A rollout ended by a motion limit is learnt from with return 0: the policy caused it. So is
      one that a fault ended, if the next attempt ends by a torque which is not explained: a contact
      may be chance, but a policy may also want more than motors give at their speed.
    * A rollout that a person ended is learnt from with return 0 and pauses the session. Its policy
      is never run again; a re-test that a person ended has failed and is the last one.
    * An infeasible policy is not executed, see `learning_run.sample`.
    * A mean that succeeds is run again, unchanged, until it fails or `StoppingRule` is satisfied;
      all these runs are learnt from.
    * The session stops when a mean is confirmed or the budget is used. Its answer is the confirmed
      mean or else the last one; the answer is re-tested and does not change any more.
    * After a rating (`rate`) the learner is rebuilt from all rollouts, with `Record.rated_return`.
      A punished rollout is no success.
    * A demonstration that is added (`add_demonstration`) is reproduced next. If its return exceeds
      the mean of the last five rollouts, learning restarts from it with the rest of the budget.
    * Ratings and demonstrations take effect on the next trial, not on the one being executed.

    Attributes:
        choice: Current demonstration and the reason for its choice, empty before the choice.
        used: Number of rollouts used of the budget.
        seconds: Time that they and all others took [s].
        stopped: Reason why learning stopped, empty while learning; re-tests may be outstanding.
        paused: Reason why nothing may move now, empty while the session goes on.
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
        """Begin a session, or resume it after the last line of `log`, oldest first.

        The context is that of `Task.context_of`, the seed (>= 0) that of the exploration. The
        candidates are not simulated: the caller checks `reproduction_of` each.

        Raises:
            ValueError: `check_candidates` refuses the candidates, the learner needs a model that
                the task does not have, or the log is of another session; names the first line
                that differs.
        """
        check_candidates(candidates, settings.practice)
        self.settings = settings
        self.task = settings.make_task(context)
        self.choice = self.stopped = self.paused = ""
        self.used, self.seconds = 0, 0.0
        self._arm = arm
        self._rng = np.random.Generator(np.random.PCG64(seed))
        self._candidates = list(candidates)
        self._parametrizations = {p.id: self.task.parametrization(p) for p in candidates}
        self._learning_run: LearningRun | None = None
        self._reproductions: list[int] = []  # rollout number for each candidate
        self._retried: Record | None = None  # whose z is executed again
        self._answer: np.ndarray | None = None  # re-tested once learning has stopped
        self._retested = 0
        self._records: list[Record] = []
        self._refused: set[tuple[str, tuple[float, ...]]] = set()  # as `Record.executed`
        self._log: list[Line] = []
        self._waiting: list[Rating | NewDemonstration] = []  # take effect after the pending trial
        self._pending: Trial | None = None
        self._learning_run_of(candidates[0].id)  # a learner without its model is refused now
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
        return (*self._candidates, *waiting)

    @property
    def parametrization(self) -> Parametrization | None:
        """Parametrization of the chosen demonstration, None before the choice."""
        return None if self._learning_run is None else self._learning_run.parametrization

    @property
    def learner(self) -> Learner | None:
        """The learner, None before the choice; read-only for callers."""
        return None if self._learning_run is None else self._learning_run.learner

    @property
    def unusable_in_a_row(self) -> int:
        """Number of latest rollouts without a return."""
        return len([*takewhile(lambda record: record.ret is None, reversed(self._records))])

    @property
    def finished(self) -> bool:
        """Whether no rollout is left to execute."""
        retested = self._answer is None or self._retested >= self.settings.practice.retests
        return bool(self.stopped) and retested and self._pending is None and self._retried is None

    @property
    def confirmed(self) -> int:
        """Number of successes that confirmed the answer; 0 while nothing has."""
        found = self._learning_run
        return 0 if found is None or not found.rule.complete else found.rule.successes

    @property
    def best(self) -> Best | None:
        """Best policy so far, see `choose_best`."""
        name = None if self._learning_run is None else self._learning_run.demonstration
        noise = self.settings.practice.return_noise
        known, answer = self._parametrizations, self._answer
        return choose_best(self._records, known, name, answer, self.stopped, noise)

    def next_trial(self) -> Trial | None:
        """Trial to execute now, the same until it is recorded; None when finished."""
        return self._next_trial(None)

    def learn(self, trial: Trial, rollout: Rollout, **logged: Any) -> Record:  # noqa: ANN401
        """Assess the rollout of the trial that `next_trial` returned, and learn from it.

        What is `logged` is the name of its `bag`, the `truth` of a simulator and its `clock`.

        Raises:
            ValueError: This is not the trial that is due, or a path is of another rollout.
        """
        if rollout.tool.id != trial.id:
            raise ValueError(f"paths are of rollout {rollout.tool.id!r}, expected {trial.id!r}")
        assessment, fault = self.task.assess(trial.policy, rollout), ""
        if not isinstance(assessment, Assessment):
            raise TypeError(f"assess of task {self.task.name!r} told {assessment!r}: no Assessment")
        if rollout.fault is not None:
            fault, before = rollout.fault.text, self._retried
            logged |= {"fault_kind": rollout.fault.kind}
            if rollout.fault.kind is FaultKind.EXTERNAL_TORQUE and before and before.fault:
                assessment = Assessment(0.0, why=f"{fault}, again: counts as return 0")
        return self.learn_assessed(trial, assessment, fault=fault, **logged)

    def awaits_rating(self, trial: Trial, rollout: Rollout) -> bool:
        """Whether a person is to rate this rollout, as of a task that nothing else judges."""
        whole = not cut_short(trial.policy, rollout, self.task.settle_time)
        return self.task.rated and rollout.fault is None and whole

    def learn_assessed(
        self,
        trial: Trial,
        assessment: Assessment,
        *,
        fault: str = "",
        refused: bool = False,
        **logged: Any,  # noqa: ANN401 - checked by the record
    ) -> Record:
        """Learn from a rollout that the caller has assessed; otherwise like `learn`.

        A `fault` is the text of the fault or the person's stop that ended it, empty without; it is
        `refused` if a person did.

        Raises:
            ValueError: This is not the trial that is due, or the return is negative or not finite.
        """
        due = self._pending
        if due is None or trial.id != due.id:
            expected = None if due is None else due.id
            raise ValueError(f"rollout {trial.id!r} is not the one that is due ({expected})")
        retest = due.kind == "retest"
        learnt = assessment.ret is not None and not retest
        return self.apply(
            Record(
                **due.logged(),
                learnt=learnt,
                z_corrected=self._corrected(due, assessment).tolist() if learnt else None,
                ret=assessment.ret,
                terms=assessment.terms,
                success=bool(assessment.success),
                why=assessment.why or retest * "a re-test is not learnt from",
                note="",
                observation=assessment.observation,
                fault=fault,
                refused=refused,
                generator=generator_state(self._rng),
                **{"bag": "", "truth": None, "clock": {}, **logged},
            )
        )

    def rate(
        self, amount: float, number: int | None = None, clock: Mapping[str, Any] | None = None
    ) -> Rating:
        """Add a person's rating to the return of a rollout, the last finished one without a number.

        Several ratings of a rollout add up.

        Raises:
            ValueError: The amount is out of range, the rollout does not exist or has no return, or
                learning has stopped.
        """
        self._check_still_learning()
        if not (np.isfinite(amount) and 0.0 < abs(amount) <= RATING_MAX):
            raise ValueError(f"a rating must be within ±{RATING_MAX} and not 0, got {amount}")
        if not self._records:
            raise ValueError("there is no finished rollout to rate yet")
        number = len(self._records) if number is None else number
        if not 1 <= number <= len(self._records):
            raise ValueError(f"rollout {number} is not one of the {len(self._records)} on record")
        record = session_log.with_ratings([*self._records, *self._waiting])[number - 1]
        before, later = record.rated_return, record.with_rating(amount).rated_return
        if before is None:
            raise ValueError(f"{record.id} has no return and is not learnt from: {record.why}")
        done = "rewarded" if amount > 0.0 else "punished"
        note = f"{record.id} {done}: return {before:.3f} -> {later:.3f}"
        after = self._effective
        return self.apply(
            Rating(after=after, rollout=number, amount=amount, note=note, clock=clock or {})
        )

    def add_demonstration(
        self, policy: Policy, bag: str = "", clock: Mapping[str, Any] | None = None
    ) -> NewDemonstration:
        """Add a further demonstration: the policy fitted to it is reproduced next.

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
        after, fitted = self._effective, plain_json.parse(to_json(policy), policy.id)
        note = f"{policy.id} is reproduced after rollout {after}{bag and f': {bag}'}"
        return self.apply(
            NewDemonstration(
                after=after, id=policy.id, policy=fitted, bag=bag, note=note, clock=clock or {}
            )
        )

    def pause(self, paused: bool, note: str, clock: Mapping[str, Any] | None = None) -> Pause:
        """Pause the session for a reason, or let it go on; returns the line to be logged."""
        after = len(self._records)
        return self.apply(Pause(after=after, paused=paused, note=note, clock=clock or {}))

    def refuse(self, trial: Trial, why: str, **logged: Any) -> Record:  # noqa: ANN401
        """Learn from a trial that a person has ended, see `learn_assessed`."""
        refused = Assessment(0.0, why=f"{why}: counts as return 0, is not run again")
        return self.learn_assessed(trial, refused, fault=why, refused=True, **logged)

    def apply(self, line: L) -> L:
        """Process a log line, new or replayed; returns it as it is to be logged.

        The figures of a replayed record are used as logged, so a session resumes exactly even on a
        processor that would round the last digit differently.

        Raises:
            ValueError: The line is not the next one of this session.
        """
        if isinstance(line, Record):
            return self._apply_record(line)
        if why := session_log.out_of_order(line, len(self._records)):
            raise ValueError(why)
        self._log.append(line)
        if isinstance(line, Pause):
            self.paused = line.note if line.paused else ""
        elif line.after == len(self._records):
            self._take_effect(line)
        else:
            self._waiting.append(line)
        return line

    def _apply_record(self, record: R) -> R:
        trial = self._next_trial(record.rejections)
        if trial is None:
            raise ValueError(f"record {record.number} ({record.id}) comes after the session's end")
        trial.check(record, generator_state(self._rng))
        self._pending = None
        self._records.append(record)
        if record.refused:
            self._refused.add(record.executed)
        note = self._advance(record)
        record = record if record.note else record.model_copy(update={"note": note})
        self._records[-1] = record
        self._log.append(record)
        waiting, self._waiting = self._waiting, []
        for event in waiting:
            self._take_effect(event)
        return record

    def _take_effect(self, event: Rating | NewDemonstration) -> None:
        if self.stopped:  # by the rollout during which the event arrived
            return
        if isinstance(event, NewDemonstration):
            policy = event.candidate()
            self._parametrizations[policy.id] = self.task.parametrization(policy)
            self._candidates.append(policy)
            return
        record = self._records[event.rollout - 1].with_rating(event.amount)
        self._records[event.rollout - 1] = record
        if self._learning_run is not None:
            self._learning_run.learn_again()
            if not record.succeeded:
                self._learning_run.rule.forget(record)

    # The next trial

    def _next_trial(self, rejections: int | None) -> Trial | None:
        """The next trial; `rejections` is given in a replay, see `learning_run.sample`."""
        if self._pending is None and not self.finished:
            trial = self._draw(len(self._records) + 1, rejections)
            if (trial.demonstration, tuple(trial.z.tolist())) in self._refused:
                self.stopped = NONE_LEFT
                self._retested = self.settings.practice.retests
                return None
            self._pending = trial
        return self._pending

    def _draw(self, number: int, rejections: int | None) -> Trial:
        if (last := self._retried) is not None:
            purpose, attempt = f"attempt {last.attempt + 1}: {last.why}", last.attempt + 1
            own, z = self._parametrizations[last.demonstration], np.array(last.z)
            return Trial.at(number, own, last.kind, z, purpose, attempt=attempt)
        if len(self._reproductions) < len(self._candidates):
            name = self._candidates[len(self._reproductions)].id
            own = self._parametrizations[name]
            return Trial.at(number, own, "reproduction", np.zeros(own.size), f"reproduces {name}")
        learning_run = self._learning_run
        if learning_run is None:
            raise ValueError("the session has ended: no demonstration was chosen")
        if self._answer is None:
            return learning_run.draw(number, rejections)
        self._answer, count = learning_run.shrunk(self._answer, rejections)
        purpose = f"re-test {self._retested + 1} of {self.settings.practice.retests}"
        own = learning_run.parametrization
        return Trial.at(number, own, "retest", self._answer, purpose, count)

    def _corrected(self, trial: Trial, assessment: Assessment) -> np.ndarray:
        """Coordinates at which a rollout is learnt from: corrected as far as it stays feasible."""
        parametrization = self._parametrizations[trial.demonstration]
        exceeded = limit_stops(self._records)
        is_feasible = feasibility(parametrization, self._arm, exceeded, "corrected")
        z = trial.z
        parts = self.task.error_correction(assessment, parametrization)
        if not parts or is_feasible(z + sum(parts)):
            return z + sum(parts)
        for part in parts:  # one at a time: an infeasible part does not prevent the others
            shares = (share for share in (1.0, 0.5, 0.25) if is_feasible(z + share * part))
            z = z + next(shares, 0.0) * part
        return z

    @property
    def _effective(self) -> int:
        """Number of rollouts after which a new line takes effect."""
        return len(self._records) + (self._pending is not None)

    def _check_still_learning(self) -> None:
        if self.stopped:
            raise ValueError(f"the session has stopped learning: {self.stopped}")

    # The decisions after a rollout

    def _advance(self, record: Record) -> str:
        """Process the newest record; returns the decision, for its note."""
        settings, self._retried = self.settings.practice, None
        self.seconds += record.clock.get("took", 0.0)
        if record.ret is None and record.attempt < settings.attempts:
            self._retried = record
            return f"not learnt from ({record.why}), tried again"
        paused = f"{record.fault}; {GO_ON}" if record.refused else ""
        self.paused = paused or self.paused
        if record.kind == "retest":
            # The others would run the policy that a person has refused.
            self._retested = settings.retests if record.refused else self._retested + 1
            return paused if record.ret is not None else "dropped"
        self.used += record.ret is not None
        note = ""
        if record.kind == "reproduction":
            note = self._advance_reproduction(record)
        elif self._learning_run is not None:
            note = self._learning_run.add(record)
        if (learning_run := self._learning_run) is not None and not self.stopped:
            self.stopped = self._end_of(learning_run)
            if self.stopped:
                self._answer = learning_run.parametrization.clip(learning_run.answer)
        return "; ".join(part for part in (note, self.stopped, paused) if part)

    def _end_of(self, learning_run: LearningRun) -> str:
        """Reason why learning ends after the newest record, empty if it goes on."""
        budget, minutes = self.settings.practice.budget, self.settings.practice.minutes
        if learning_run.rule.complete:
            return f"the mean policy is confirmed: {learning_run.rule.complete}"
        if self.used >= budget:
            return f"budget of {budget} rollouts used"
        if 0 < minutes <= self.seconds / 60.0:
            return f"budget of {minutes} min used"
        if len(self._records) >= 3 * budget:
            return f"{3 * budget} rollouts, of which only {self.used} were usable"
        return ""

    def _advance_reproduction(self, record: Record) -> str:
        self._reproductions.append(record.number)
        if self._learning_run is not None:
            return self._compare(record, self._learning_run)
        if len(self._reproductions) < len(self._candidates):
            return ""
        chosen, why = choose_demonstration([self._records[n - 1] for n in self._reproductions])
        if chosen is None:
            self.stopped = why
            return ""
        return self._learn_from(chosen, why)

    def _compare(self, record: Record, present: LearningRun) -> str:
        """Switch to a demonstration that was added later if its reproduction is better."""
        own = [r.rated_return for r in self._records if r.demonstration == present.demonstration]
        recent = [ret for ret in own if ret is not None][-COMPARED_ROLLOUTS:]
        level = float(np.mean(recent))
        if record.ret is None or record.fault:
            return f"goes on with {present.demonstration}: {record.why}"
        compared = f"return {record.ret:.3f} against {level:.3f} of the last {len(recent)}"
        if record.ret <= level:
            return f"goes on with {present.demonstration}: {compared}"
        why = f"{compared}, from {present.demonstration}"
        return self._learn_from(record, why, present.practised)

    def _learn_from(self, reproduction: Record, why: str, practised: int = 0) -> str:
        demonstration = reproduction.demonstration
        self.choice = f"learns from {demonstration}: {why}"
        self._learning_run = self._learning_run_of(demonstration, practised)
        return "; ".join(filter(None, (self.choice, self._learning_run.rule.add(reproduction))))

    def _learning_run_of(self, demonstration: str, practised: int = 0) -> LearningRun:
        of, settings, task = self._parametrizations[demonstration], self.settings, self.task
        return LearningRun(of, settings, task, self._rng, self._arm, self._records, practised)
