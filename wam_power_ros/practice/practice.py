# SPDX-License-Identifier: Apache-2.0
"""The course of a session: which policy is tried next, and how a finished rollout is used.

A session reproduces every demonstration once on the arm, chooses the one to learn from by its
reproduction, explores, runs the mean now and then, stops by a rule, and re-tests its answer.
Meanwhile a person may rate rollouts and add demonstrations. Everything `Practice` knows follows
from its arguments and its log, and every line of the log, live or replayed, goes through
`Practice.apply`; so replaying a log rebuilds the practice bit for bit. No ROS, no files, no clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from wam_power_ros.learning.learner import Learner, generator_state
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy, check_id
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.practice.best_policy import Best, choose_best
from wam_power_ros.practice.choose_demonstration import choose_demonstration
from wam_power_ros.practice.feedback import make_demonstration, make_rating
from wam_power_ros.practice.improvement import ArmModel, Improvement, LearnerFactory
from wam_power_ros.practice.session_log import (
    Event,
    Line,
    NewDemonstration,
    Rating,
    Record,
    plain,
)
from wam_power_ros.practice.settings import PracticeSettings, SessionSettings
from wam_power_ros.practice.trial import Draw, Trial
from wam_power_ros.tasks.task import Assessment, Task

RECENT = 5  # rollouts whose mean return a demonstration added later has to exceed
L = TypeVar("L", bound=Line)


def reproduction_of(candidate: Policy, task: Task) -> Policy:
    """The policy that reproduces a demonstration: the candidate at z = 0 of its parametrization."""
    parametrization = task.parametrization(candidate)
    return parametrization.policy(np.zeros(parametrization.size), candidate.id)[0]


def check_candidates(candidates: Sequence[Policy], settings: PracticeSettings) -> None:
    """Check what a session begins with.

    Raises:
        ValueError: No candidates, two of the same id, or a budget that leaves no practice.
    """
    ids = [policy.id for policy in candidates]
    if not ids:
        raise ValueError("no candidate: a session needs at least one demonstration")
    if len(set(ids)) != len(ids):
        raise ValueError(f"candidates must have different ids, got {ids}")
    if settings.budget <= len(ids):
        raise ValueError(
            f"a budget of {settings.budget} rollouts leaves none to practise "
            f"after {len(ids)} reproductions"
        )


class Practice:
    """A session from its first reproduction to its last re-test.

    Call `next_trial`, execute it, call `learn` with its rollout, make the record durable, and so on
    until `next_trial` has none. The rules:

    * Each candidate is reproduced once; `choose_demonstration` chooses one; the learner is given
      its reproduction as z = 0.
    * A rollout without a return says nothing about its policy: it is not learnt from and the same z
      is tried again, up to `attempts` times, so that a passing failure leaves the course of
      learning as it would have been. Then it is dropped.
    * A rollout ended by a limit of motion is learnt from with return 0: the policy caused it.
    * An infeasible policy is not tried, see `FeasibleSampler`.
    * A mean that succeeds is run again, unchanged, until it fails or has succeeded `confirm` times
      in a row; all these runs are learnt from. Returns are noisy and an elite keeps its lucky
      rollouts for ever; running the mean again separates luck from skill.
    * The session stops at that, or when the budget is used. Its answer is the confirmed mean or
      the last one; it is re-tested and not changed any more.
    * A person may add to the return of any usable rollout until then (`rate`): the learner is given
      everything again, with `Record.rated_return`. A punished rollout is no success.
    * A person may add a demonstration until then (`add_demonstration`). It is reproduced next. If
      its return exceeds the mean of the last five rollouts, it is learnt from instead, from the
      beginning and with what is left of the budget; if not, learning goes on as it was. The two
      are not mixed: a weighted mean of different demonstrations smooths out the peaks of
      acceleration that make a toss ([Kormushev2010], Sec. IV).
    * Ratings and demonstrations take effect on the next trial that is drawn, not on the one under
      way.
    """

    def __init__(
        self,
        candidates: Sequence[Policy],
        settings: PracticeSettings,
        task: Task,
        learner: LearnerFactory,
        seed: int,
        arm: ArmModel,
    ) -> None:
        """Begin a session.

        Args:
            candidates: Policies fitted to the demonstrations, each with an id of its own.
            settings: Settings of its course.
            task: Task that is practised.
            learner: Makes a learner, see `SessionSettings.make_learner`.
            seed: Seed of the exploration, >= 0.
            arm: Model of the arm. It is not asked about these candidates: ask it yourself about
                `reproduction_of` each.

        Raises:
            ValueError: No candidates, two of the same id, or a budget that leaves no practice.
        """
        check_candidates(candidates, settings)
        self.settings = settings
        self.task = task
        self.seed = seed
        self._make_learner = learner
        self._arm = arm
        self._candidates = list(candidates)
        self._parametrizations = {p.id: task.parametrization(p) for p in candidates}
        self._rng = np.random.Generator(np.random.PCG64(seed))
        self._records: list[Record] = []
        self._log: list[Line] = []
        self._waiting: list[Event] = []  # for the end of the trial under way
        self._pending: Trial | None = None
        self._retry: Draw | None = None
        self._reproductions: list[int] = []  # numbers of the rollouts, one a candidate
        self._improvement: Improvement | None = None  # of the chosen demonstration
        self._choice = ""
        self._used = 0  # usable rollouts, of the budget
        self._stopped = ""
        self._answer: np.ndarray | None = None
        self._retested = 0

    @classmethod
    def of(
        cls,
        settings: SessionSettings,
        context: Mapping[str, Any],
        candidates: Sequence[Policy],
        seed: int,
        arm: ArmModel,
        log: Sequence[Line] = (),
    ) -> Practice:
        """Practice of a session as it was after the last line of `log`.

        Raises:
            ValueError: The log is not that of such a session; names the first line that differs.
        """
        task = settings.make_task(context)
        practice = cls(candidates, settings.practice, task, settings.make_learner, seed, arm)
        for line in log:
            practice.apply(line)
        return practice

    @property
    def log(self) -> tuple[Line, ...]:
        """All lines so far, oldest first."""
        return tuple(self._log)

    @property
    def records(self) -> tuple[Record, ...]:
        """All rollouts so far, oldest first, with the ratings that have taken effect."""
        return tuple(self._records)

    @property
    def candidates(self) -> tuple[Policy, ...]:
        """Policies of all demonstrations, those added later included."""
        waiting = [e.candidate() for e in self._waiting if isinstance(e, NewDemonstration)]
        return (*self._candidates, *waiting)

    @property
    def parametrization(self) -> Parametrization | None:
        """Parametrization of the chosen demonstration, None before the choice."""
        return None if self._improvement is None else self._improvement.parametrization

    @property
    def learner(self) -> Learner | None:
        """The learner, None before the choice; to be read only."""
        return None if self._improvement is None else self._improvement.learner

    @property
    def choice(self) -> str:
        """Demonstration that is learnt from and why, empty before the choice."""
        return self._choice

    @property
    def used(self) -> int:
        """Number of rollouts used of the budget."""
        return self._used

    @property
    def unusable_in_a_row(self) -> int:
        """Number of rollouts up to now from which nothing could be learnt."""
        count = 0
        for record in reversed(self._records):
            if record.ret is not None:
                break
            count += 1
        return count

    @property
    def stopped(self) -> str:
        """Reason why nothing more is learnt, empty while learning; re-tests may be outstanding."""
        return self._stopped

    @property
    def finished(self) -> bool:
        """Whether there is nothing more to execute."""
        if self._pending is not None or self._retry is not None:
            return False
        return bool(self._stopped) and (
            self._answer is None or self._retested >= self.settings.retests
        )

    @property
    def best(self) -> Best | None:
        """The policy to save as the best so far, see `choose_best`."""
        chosen = choose_best(
            self._records,
            None if self._improvement is None else self._improvement.demonstration,
            self._answer,
            self._stopped,
            self.settings.return_noise,
        )
        if chosen is None:
            return None
        runs, why = chosen
        policy, _ = self._parametrizations[runs.demonstration].policy(runs.z, runs.id)
        return Best(policy, tuple(runs.returns), runs.successes, why)

    def next_trial(self) -> Trial | None:
        """Rollout to execute now, the same until it is on record; None when finished."""
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
            ValueError: Not the trial that is due, or a path of another rollout.
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
        """Like `learn`, of a rollout that was assessed elsewhere.

        Raises:
            ValueError: Not the trial that is due, or a return that cannot be learnt from.
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
            The line, to be appended to the log before anything else.

        Raises:
            ValueError: Not a rating, no such rollout, one that is not learnt from, or nothing is
                learnt any more.
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
            policy: Policy fitted to the demonstration, with an id of its own.
            bag: Bag of the demonstration, logged only.
            clock: Wall-clock figures, logged only.

        Returns:
            The line, to be appended to the log before anything else.

        Raises:
            ValueError: The id is taken, the policy does not have the parameters that are learnt,
                it is infeasible, or nothing is learnt any more.
        """
        self._check_still_learning()
        check_id(policy.id)
        if policy.id in [candidate.id for candidate in self.candidates]:
            raise ValueError(f"there is a demonstration {policy.id!r} already")
        if fault := self._arm.infeasible(reproduction_of(policy, self.task)):
            raise ValueError(f"{policy.id} is infeasible: {fault.text}")
        return self.apply(make_demonstration(policy, self._effective, bag, clock))

    def apply(self, line: L) -> L:
        """Take up a line of the log, one that was just made or one that is replayed.

        A replayed record's figures are used, so a log goes on where it was even where another
        processor would have rounded its last digit differently.

        Returns:
            The line as it belongs into the log.

        Raises:
            ValueError: It is not what comes next in this session.
        """
        if isinstance(line, Record):
            self._check_is_due(line)
            note = self._advance(line)
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
            raise ValueError(f"rollout {line.rollout} was rated before it was on record")
        self._log.append(line)
        if line.after == len(self._records):
            self._take_effect(line)
        else:
            self._waiting.append(line)
        return line

    # Drawing

    def _next_trial(self, rejections: int | None) -> Trial | None:
        """The next trial; `rejections` is known when it is replayed."""
        if self._pending is None and not self.finished:
            draw = self._draw(rejections)
            number = len(self._records) + 1
            trial_id = f"trial-{number:04d}"
            parametrization = self._parametrizations[draw.demonstration]
            policy, z = parametrization.policy(draw.z, trial_id)
            theta = parametrization.theta(z)
            z.setflags(write=False)
            theta.setflags(write=False)
            self._pending = Trial(
                **{**vars(draw), "z": z}, number=number, id=trial_id, policy=policy, theta=theta
            )
        return self._pending

    def _draw(self, rejections: int | None) -> Draw:
        if self._retry is not None:
            return self._retry
        if len(self._reproductions) < len(self._candidates):
            candidate = self._candidates[len(self._reproductions)]
            zero = np.zeros(self._parametrizations[candidate.id].size)
            return Draw("reproduction", candidate.id, zero, 1, 0, f"reproduces {candidate.id}")
        if self._improvement is None:
            raise ValueError("a session that never chose a demonstration is over")
        if self._answer is None:
            return self._improvement.draw(self._records, rejections)
        draw = self._improvement.draw_feasible(self._answer, self._records, rejections)
        self._answer = draw.z
        purpose = f"re-test {self._retested + 1} of {self.settings.retests}"
        return replace(draw, kind="retest", purpose=purpose)

    def _in_hindsight(self, trial: Trial, assessment: Assessment) -> np.ndarray:
        """Coordinates a rollout is learnt from at: corrected, but not to where it is infeasible."""
        parametrization = self._parametrizations[trial.demonstration]

        def feasible(z: np.ndarray) -> bool:
            return self._arm.infeasible(parametrization.policy(z, "corrected")[0]) is None

        z = trial.z
        parts = self.task.hindsight(assessment, parametrization)
        if not parts or feasible(z + sum(parts)):
            return z + sum(parts)
        for part in parts:  # one that the arm cannot follow does not keep the others back
            shares = (share for share in (1.0, 0.5, 0.25) if feasible(z + share * part))
            z = z + next(shares, 0.0) * part
        return z

    # Taking up

    def _check_is_due(self, record: Record) -> None:
        """Raise ValueError if a record is not of the trial that is due."""
        trial = self._next_trial(record.rejections)
        if trial is None:
            raise ValueError(f"record {record.number} ({record.id}) comes after the session's end")
        for name in ("number", "id", "kind", "demonstration", "attempt"):
            wanted, got = getattr(trial, name), getattr(record, name)
            if wanted != got:
                raise ValueError(
                    f"record {len(self._records) + 1}: {name} is {got!r}, "
                    f"this session's was {wanted!r}: other settings, seed or candidates?"
                )
        same_z = len(record.z) == len(trial.z) and np.allclose(record.z, trial.z, rtol=0, atol=1e-6)
        if not same_z or record.generator != generator_state(self._rng):
            raise ValueError(
                f"record {record.number}: {'the generator' if same_z else 'z'} is not this "
                "session's: other settings, seed or candidates?"
            )

    @property
    def _effective(self) -> int:
        """Number of rollouts after which a line made now takes effect."""
        return len(self._records) + (self._pending is not None)

    def _check_still_learning(self) -> None:
        if self._stopped:
            raise ValueError(f"nothing is learnt any more: {self._stopped}")

    def _take_effect(self, event: Event) -> None:
        if self._stopped:  # by the very rollout that was under way when it came
            return
        if isinstance(event, NewDemonstration):
            policy = event.candidate()
            self._parametrizations[policy.id] = self.task.parametrization(policy)
            self._candidates.append(policy)
            return
        record = self._records[event.rollout - 1]
        total = (record.adjustment or 0.0) + event.amount
        record = record.model_copy(update={"adjustment": total})
        self._records[event.rollout - 1] = record
        if self._improvement is not None:
            self._improvement.learn_again(self._records)
            if not record.succeeded:
                self._improvement.forget_success(record)

    def _advance(self, record: Record) -> str:
        """Bring everything up to date with a record; returns the decision for its note."""
        self._pending = None
        self._records.append(record)
        z = np.array(record.z)
        if record.ret is None and record.attempt < self.settings.attempts:
            attempt = record.attempt + 1
            purpose = f"attempt {attempt}: {record.why}"
            self._retry = Draw(record.kind, record.demonstration, z, attempt, 0, purpose)
            return f"not learnt from ({record.why}), tried again"
        self._retry = None
        if record.kind == "retest":
            self._retested += 1
            return "" if record.ret is not None else "dropped"
        self._used += record.ret is not None
        if record.kind == "reproduction":
            note = self._advance_reproduction(record)
        else:
            note = self._advance_practice(record, z)
        if self._improvement is not None and not self._stopped:
            answer = self._improvement.answer
            limit = 3 * self.settings.budget
            if self._used >= self.settings.budget:
                self._stop(answer, f"budget of {self.settings.budget} rollouts used")
            elif len(self._records) >= limit:
                self._stop(answer, f"{limit} rollouts, of which only {self._used} were usable")
        return "; ".join(part for part in (note, self._stopped) if part)

    def _advance_reproduction(self, record: Record) -> str:
        self._reproductions.append(record.number)
        if self._improvement is not None:
            return self._compare(record, self._improvement)
        if len(self._reproductions) < len(self._candidates):
            return ""
        reproductions = [self._records[number - 1] for number in self._reproductions]
        try:
            index, why = choose_demonstration(reproductions)
        except ValueError as error:
            self._stopped = str(error)
            return ""
        self._learn_from(reproductions[index].demonstration, why)
        return self._choice

    def _compare(self, record: Record, present: Improvement) -> str:
        """Learn from a demonstration that was added later, if it is the better one."""
        recent = [
            float(other.rated_return)
            for other in self._records
            if other.demonstration == present.demonstration and other.rated_return is not None
        ][-RECENT:]
        level = float(np.mean(recent))
        if record.ret is None or record.fault:
            return f"goes on with {present.demonstration}: {record.why}"
        compared = f"return {record.ret:.3f} against {level:.3f} of the last {len(recent)}"
        if record.ret <= level:
            return f"goes on with {present.demonstration}: {compared}"
        why = f"{compared}, from {present.demonstration}"
        self._learn_from(record.demonstration, why, present.practised)
        return self._choice

    def _learn_from(self, demonstration: str, why: str, practised: int = 0) -> None:
        self._choice = f"learns from {demonstration}: {why}"
        self._improvement = Improvement(
            self._parametrizations[demonstration],
            self.settings,
            self.task,
            self._make_learner,
            self._rng,
            self._arm,
            self._records,
            practised,
        )

    def _advance_practice(self, record: Record, z: np.ndarray) -> str:
        """Take up a trial that explored or ran the mean."""
        if self._improvement is None:
            raise ValueError(f"record {record.number}: {record.kind} before the choice")
        note = self._improvement.add(record)
        if self._improvement.confirmed:
            self._stop(z, f"a mean succeeded {self.settings.confirm} times in a row")
        return note

    def _stop(self, answer: np.ndarray, why: str) -> None:
        if self._improvement is not None:
            self._answer = self._improvement.parametrization.clip(answer)
        self._stopped = why
