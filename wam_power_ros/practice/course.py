# SPDX-License-Identifier: Apache-2.0
"""The course of a session: reproductions, choice, practice, stopping, re-tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.best_policy import Best, choose_best
from wam_power_ros.practice.choose_demonstration import choose_demonstration
from wam_power_ros.practice.improvement import ArmModel, Improvement, LearnerFactory
from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.practice.trial import Draw
from wam_power_ros.tasks.task import Task

RECENT = 5  # rollouts whose mean return a demonstration added later has to exceed


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


class Course:
    """Draws the coordinates that are tried next, and takes up their records.

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

    Attributes:
        settings: Settings of the course.
        candidates: Policies of the demonstrations that have taken effect.
        parametrizations: Their parametrizations, by id.
        improvement: Practice of the chosen demonstration, None before the choice.
        choice: Demonstration that is learnt from and why, empty before the choice.
        used: Number of rollouts used of the budget.
        stopped: Reason why nothing more is learnt, empty while learning.
    """

    def __init__(
        self,
        candidates: Sequence[Policy],
        settings: PracticeSettings,
        task: Task,
        make_learner: LearnerFactory,
        rng: np.random.Generator,
        arm: ArmModel,
    ) -> None:
        """Begin with these candidates.

        Raises:
            ValueError: No candidates, two of the same id, or a budget that leaves no practice.
        """
        check_candidates(candidates, settings)
        self.settings = settings
        self._task, self._make_learner, self._rng, self._arm = task, make_learner, rng, arm
        self.candidates = list(candidates)
        self.parametrizations = {p.id: task.parametrization(p) for p in candidates}
        self.improvement: Improvement | None = None
        self.choice = ""
        self.used = 0
        self.stopped = ""
        self._retry: Draw | None = None
        self._reproductions: list[int] = []  # numbers of the rollouts, one a candidate
        self._answer: np.ndarray | None = None
        self._retested = 0

    @property
    def finished(self) -> bool:
        """Whether there is nothing more to draw."""
        return (
            self._retry is None
            and bool(self.stopped)
            and (self._answer is None or self._retested >= self.settings.retests)
        )

    def best(self, records: Sequence[Record]) -> Best | None:
        """The policy to save as the best so far, see `choose_best`."""
        chosen = choose_best(
            records,
            None if self.improvement is None else self.improvement.demonstration,
            self._answer,
            self.stopped,
            self.settings.return_noise,
        )
        if chosen is None:
            return None
        runs, why = chosen
        policy, _ = self.parametrizations[runs.demonstration].policy(runs.z, runs.id)
        return Best(policy, tuple(runs.returns), runs.successes, why)

    def add_candidate(self, policy: Policy) -> None:
        """Add a further demonstration, which is reproduced next."""
        self.parametrizations[policy.id] = self._task.parametrization(policy)
        self.candidates.append(policy)

    def rated(self, record: Record, records: Sequence[Record]) -> None:
        """Learn again, after a person has changed the return of a record."""
        if self.improvement is not None:
            self.improvement.learn_again(records)
            if not record.succeeded:
                self.improvement.forget_success(record)

    def draw(self, records: Sequence[Record], rejections: int | None) -> Draw:
        """The rollout to execute next; not to be called when `finished`.

        Args:
            records: Rollouts of the session so far.
            rejections: Number of rejections, where it is known; see `FeasibleSampler`.
        """
        if self._retry is not None:
            return self._retry
        if len(self._reproductions) < len(self.candidates):
            candidate = self.candidates[len(self._reproductions)]
            zero = np.zeros(self.parametrizations[candidate.id].size)
            return Draw("reproduction", candidate.id, zero, 1, 0, f"reproduces {candidate.id}")
        if self.improvement is None:
            raise ValueError("a session that never chose a demonstration is over")
        if self._answer is None:
            return self.improvement.draw(records, rejections)
        draw = self.improvement.draw_feasible(self._answer, records, rejections)
        self._answer = draw.z
        purpose = f"re-test {self._retested + 1} of {self.settings.retests}"
        return replace(draw, kind="retest", purpose=purpose)

    def advance(self, records: Sequence[Record]) -> str:
        """Take up the newest of the records; returns the decision, for its note."""
        record = records[-1]
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
        self.used += record.ret is not None
        if record.kind == "reproduction":
            note = self._advance_reproduction(record, records)
        else:
            note = self._advance_practice(record, z)
        if self.improvement is not None and not self.stopped:
            answer = self.improvement.answer
            limit = 3 * self.settings.budget
            if self.used >= self.settings.budget:
                self._stop(answer, f"budget of {self.settings.budget} rollouts used")
            elif len(records) >= limit:
                self._stop(answer, f"{limit} rollouts, of which only {self.used} were usable")
        return "; ".join(part for part in (note, self.stopped) if part)

    def _advance_reproduction(self, record: Record, records: Sequence[Record]) -> str:
        self._reproductions.append(record.number)
        if self.improvement is not None:
            return self._compare(record, records, self.improvement)
        if len(self._reproductions) < len(self.candidates):
            return ""
        reproductions = [records[number - 1] for number in self._reproductions]
        try:
            index, why = choose_demonstration(reproductions)
        except ValueError as error:
            self.stopped = str(error)
            return ""
        self._learn_from(reproductions[index].demonstration, why, records)
        return self.choice

    def _compare(self, record: Record, records: Sequence[Record], present: Improvement) -> str:
        """Learn from a demonstration that was added later, if it is the better one."""
        recent = [
            float(other.rated_return)
            for other in records
            if other.demonstration == present.demonstration and other.rated_return is not None
        ][-RECENT:]
        level = float(np.mean(recent))
        if record.ret is None or record.fault:
            return f"goes on with {present.demonstration}: {record.why}"
        compared = f"return {record.ret:.3f} against {level:.3f} of the last {len(recent)}"
        if record.ret <= level:
            return f"goes on with {present.demonstration}: {compared}"
        why = f"{compared}, from {present.demonstration}"
        self._learn_from(record.demonstration, why, records, present.practised)
        return self.choice

    def _learn_from(
        self, demonstration: str, why: str, records: Sequence[Record], practised: int = 0
    ) -> None:
        self.choice = f"learns from {demonstration}: {why}"
        self.improvement = Improvement(
            self.parametrizations[demonstration],
            self.settings,
            self._task,
            self._make_learner,
            self._rng,
            self._arm,
            records,
            practised,
        )

    def _advance_practice(self, record: Record, z: np.ndarray) -> str:
        """Take up a trial that explored or ran the mean."""
        if self.improvement is None:
            raise ValueError(f"record {record.number}: {record.kind} before the choice")
        note = self.improvement.add(record)
        if self.improvement.confirmed:
            self._stop(z, f"a mean succeeded {self.settings.confirm} times in a row")
        return note

    def _stop(self, answer: np.ndarray, why: str) -> None:
        if self.improvement is not None:
            self._answer = self.improvement.parametrization.clip(answer)
        self.stopped = why
