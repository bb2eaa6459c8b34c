# SPDX-License-Identifier: Apache-2.0
"""Course of a session: reproductions, choice of a demonstration, practice, stopping, re-tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.best_policy import Best, choose_best
from wam_power_ros.practice.choose_demonstration import choose_demonstration
from wam_power_ros.practice.improvement import ArmModel, Improvement
from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings, SessionSettings
from wam_power_ros.practice.trial import Draw
from wam_power_ros.tasks.task import Task

COMPARED_ROLLOUTS = 5  # latest ones, whose mean return a demonstration added later must exceed


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
    if settings.budget <= len(ids):
        raise ValueError(
            f"a budget of {settings.budget} rollouts leaves none to practise "
            f"after {len(ids)} reproductions"
        )


class Course:
    """Selects the coordinates to execute next and processes the resulting records.

    * Each candidate is reproduced once; `choose_demonstration` chooses one; its reproduction is the
      learner's first rollout, at z = 0.
    * A rollout without a return is no evidence about its policy: nothing is learnt from it and the
      same z is executed again, up to `attempts` times, then dropped. So a transient failure does
      not change the course of learning.
    * A rollout ended by a motion limit is learnt from with return 0: the policy caused it.
    * An infeasible policy is not executed, see `feasible_sampler`.
    * A mean that succeeds is run again, unchanged, until it fails or has succeeded `confirm` times
      in a row; all these runs are learnt from. Returns are noisy and lucky rollouts stay in the
      elite for ever; running the mean again separates luck from skill.
    * The session stops when a mean is confirmed or the budget is used. Its answer is the confirmed
      mean or else the last one; the answer is re-tested and does not change any more.

    Attributes:
        candidates: Policies of the demonstrations that have taken effect.
        parametrizations: Their parametrizations, by id.
        improvement: Practice of the chosen demonstration, None before the choice.
        choice: Current demonstration and the reason for its choice, empty before the choice.
        used: Number of rollouts used of the budget.
        stopped: Reason why learning stopped, empty while learning.
    """

    def __init__(
        self,
        candidates: Sequence[Policy],
        settings: SessionSettings,
        task: Task,
        rng: np.random.Generator,
        arm: ArmModel,
    ) -> None:
        """Begin with these candidates.

        Raises:
            ValueError: `check_candidates` refuses them.
        """
        check_candidates(candidates, settings.practice)
        self._session_settings, self._settings = settings, settings.practice
        self._task, self._rng, self._arm = task, rng, arm
        self.candidates = list(candidates)
        self.parametrizations = {p.id: task.parametrization(p) for p in candidates}
        self.improvement: Improvement | None = None
        self.choice = ""
        self.used = 0
        self.stopped = ""
        self._retry: Draw | None = None
        self._reproductions: list[int] = []  # rollout number for each candidate
        self._answer: np.ndarray | None = None
        self._retested = 0

    @property
    def finished(self) -> bool:
        """Whether no rollout is left to execute."""
        return (
            self._retry is None
            and bool(self.stopped)
            and (self._answer is None or self._retested >= self._settings.retests)
        )

    def best(self, records: Sequence[Record]) -> Best | None:
        """Best policy so far, see `choose_best`."""
        chosen = choose_best(
            records,
            None if self.improvement is None else self.improvement.demonstration,
            self._answer,
            self.stopped,
            self._settings.return_noise,
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

    def apply_rating(self, record: Record, records: Sequence[Record]) -> None:
        """Rebuild the learner after a person has changed the return of a record."""
        if self.improvement is not None:
            self.improvement.learn_again(records)
            if not record.succeeded:
                self.improvement.forget_success(record)

    def draw(self, records: Sequence[Record], rejections: int | None) -> Draw:
        """Rollout to execute next; not to be called when `finished`.

        Args:
            records: Rollouts of the session so far.
            rejections: Logged number of rejections in a replay, else None; see
                `feasible_sampler.sample`.
        """
        if self._retry is not None:
            return self._retry
        if len(self._reproductions) < len(self.candidates):
            candidate = self.candidates[len(self._reproductions)]
            zero = np.zeros(self.parametrizations[candidate.id].size)
            return Draw("reproduction", candidate.id, zero, 1, 0, f"reproduces {candidate.id}")
        if self.improvement is None:
            raise ValueError("the session has ended: no demonstration was chosen")
        if self._answer is None:
            return self.improvement.draw(records, rejections)
        draw = self.improvement.draw_feasible(self._answer, records, rejections)
        self._answer = draw.z
        purpose = f"re-test {self._retested + 1} of {self._settings.retests}"
        return replace(draw, kind="retest", purpose=purpose)

    def advance(self, records: Sequence[Record]) -> str:
        """Process the newest record; returns the decision, for its note."""
        record = records[-1]
        z = np.array(record.z)
        if record.ret is None and record.attempt < self._settings.attempts:
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
            limit = 3 * self._settings.budget
            if self.used >= self._settings.budget:
                self._stop(answer, f"budget of {self._settings.budget} rollouts used")
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
        """Switch to a demonstration that was added later if its reproduction is better."""
        recent = [
            float(other.rated_return)
            for other in records
            if other.demonstration == present.demonstration and other.rated_return is not None
        ][-COMPARED_ROLLOUTS:]
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
            self._session_settings,
            self._task,
            self._rng,
            self._arm,
            records,
            practised,
        )

    def _advance_practice(self, record: Record, z: np.ndarray) -> str:
        """Process a record of an exploration or of the mean."""
        if self.improvement is None:
            raise ValueError(f"record {record.number}: {record.kind} before the choice")
        note = self.improvement.add(record)
        if self.improvement.confirmed:
            self._stop(z, f"a mean succeeded {self._settings.confirm} times in a row")
        return note

    def _stop(self, answer: np.ndarray, why: str) -> None:
        if self.improvement is not None:
            self._answer = self.improvement.parametrization.clip(answer)
        self.stopped = why
