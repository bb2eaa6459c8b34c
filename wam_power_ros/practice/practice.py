# SPDX-License-Identifier: Apache-2.0
"""The course of a session: which policy is tried next, and what is made of its outcome.

A session reproduces every demonstration once on the arm, chooses the one to learn from by its
reproduction, explores, runs the mean now and then, stops by a rule, and re-tests its answer.
Meanwhile a person may rate rollouts and give further demonstrations. Everything `Practice` knows
follows from its candidates, settings, seed and log, so replaying the lines of a log rebuilds it bit
for bit. No ROS, no files, no clock.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from wam_power_ros.learning.learner import generator_state
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy, check_id, to_json
from wam_power_ros.learning.power import Power
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Fault
from wam_power_ros.practice.best_policy import Best, evidence_of
from wam_power_ros.practice.feasible_sampler import Permission
from wam_power_ros.practice.session_log import Event, Given, Kind, Line, Rating, Record, plain
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.practice.stopping_rule import Confirmation
from wam_power_ros.practice.trial import Retry, Trial
from wam_power_ros.tasks.flip.assessment import Assessment, assess, choose_demonstration
from wam_power_ros.tasks.flip.landing_correction import corrected
from wam_power_ros.tasks.flip.parametrization import flip_parametrization

_RECENT = 5  # rollouts whose mean return a demonstration given later has to exceed
RATING_MAX = 1.0  # of one rating: a whole return
E = TypeVar("E", Rating, Given)


def reproduced(candidate: Policy, settings: PracticeSettings) -> Policy:
    """The policy that reproduces a demonstration: the candidate in the parameters of a session."""
    parameters = flip_parametrization(candidate, settings.variant, settings.noise)
    return parameters.policy(np.zeros(parameters.size), candidate.id)[0]


class Practice:
    """A session from its first reproduction to its last re-test.

    Call `next_trial`, execute it, call `learn` with what came of it, make the record durable, and
    so on until `next_trial` has none. The rules:

    * Each candidate is reproduced once; `choose_demonstration` chooses one; the learner is told
      its reproduction as z = 0.
    * A rollout that was cut short or in which the pancake was lost from view says nothing about
      its policy: it is not learnt from and the same z is tried again, up to `attempts` times, so
      that a passing failure leaves the course of learning as it would have been. Then it is
      dropped.
    * A rollout ended by a motion limit (over-speed, workspace) is learnt from with return 0: the
      policy brought that about itself.
    * What is forbidden is not tried: a sample is drawn again, and a mean, an answer or the last of
      20 such samples is drawn back, halfway and halfway again, to the best rollout so far that
      ended without a fault.
    * A mean that succeeds is run again, unchanged, until it fails or has succeeded `confirm` times
      in a row; all these runs are learnt from. Returns are noisy and an elite keeps its lucky
      rollouts for ever; running the mean again is what tells luck from skill.
    * The session stops at that, or when the budget is used. Its answer is the confirmed mean or
      the last one; it is re-tested and not changed any more.
    * A person may add to the return of any usable rollout until then (`rate`): the learner is told
      everything again, with `Record.worth` for its return. A punished rollout is no success.
    * A person may give a further demonstration until then (`give`). It is reproduced next. If that
      is worth more than the mean of the last five rollouts, it is learnt from instead, from the
      beginning and with what is left of the budget; if not, learning goes on as it was. The two
      are not mixed: a weighted mean of different demonstrations smooths out the peaks of
      acceleration that make a toss ([Kormushev2010], Sec. IV).
    * What a person does takes effect on the next trial that is drawn, not on the one under way.
    """

    def __init__(
        self,
        candidates: Sequence[Policy],
        settings: PracticeSettings,
        seed: int,
        forbidden: Callable[[Policy], str] = lambda policy: "",
    ) -> None:
        """Begin a session.

        Args:
            candidates: policies fitted to the demonstrations, each with an id of its own.
            settings: see there.
            seed: of the exploration, >= 0.
            forbidden: why the arm must not try a policy, empty if it may; the same policy must
                always get the same answer. Not asked about these candidates: ask it yourself
                about what `reproduced` gives of each.

        Raises:
            ValueError: no candidates, two of the same id, or a budget that leaves no practice.
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
        self.settings = settings
        self.seed = seed
        self._forbidden = forbidden
        self._candidates = list(candidates)
        self._parameters = {
            policy.id: flip_parametrization(policy, settings.variant, settings.noise)
            for policy in candidates
        }
        self._rng = np.random.Generator(np.random.PCG64(seed))
        self._records: list[Record] = []
        self._log: list[Line] = []
        self._events: list[Event] = []  # that wait for the end of the trial under way
        self._pending: Trial | None = None
        self._retry: Retry | None = None
        self._reproductions: list[int] = []  # numbers of the rollouts, one a candidate
        self._demonstration: str | None = None
        self._choice = ""
        self._learner: Power | None = None
        self._permission: Permission | None = None  # with the learner
        self._used = 0  # usable rollouts, of the budget
        self._practised = 0  # trials of the practice that are over, dropped ones included
        self._confirmation = Confirmation(settings)
        self._stopped = ""
        self._answer: np.ndarray | None = None
        self._retested = 0

    @classmethod
    def from_records(
        cls,
        candidates: Sequence[Policy],
        settings: PracticeSettings,
        seed: int,
        log: Sequence[Line],
        forbidden: Callable[[Policy], str] = lambda policy: "",
    ) -> Practice:
        """Practice as it was after the last line of `log`.

        Raises:
            ValueError: the log is not that of such a session; names the first line that differs.
        """
        practice = cls(candidates, settings, seed, forbidden)
        for line in log:
            practice.replay(line)
        return practice

    @property
    def log(self) -> tuple[Line, ...]:
        """All that happened so far, oldest first: what `from_records` needs."""
        return tuple(self._log)

    @property
    def records(self) -> tuple[Record, ...]:
        """All rollouts so far, oldest first, with the ratings that have taken effect."""
        return tuple(self._records)

    @property
    def candidates(self) -> tuple[Policy, ...]:
        """Policies of all demonstrations, those given later included."""
        waiting = [event.candidate() for event in self._events if isinstance(event, Given)]
        return (*self._candidates, *waiting)

    @property
    def parameters(self) -> Parametrization | None:
        """Parameters of the chosen demonstration, None before the choice."""
        return None if self._demonstration is None else self._parameters[self._demonstration]

    @property
    def learner(self) -> Power | None:
        """The learner, None before the choice. Not to be told by anyone else."""
        return self._learner

    @property
    def choice(self) -> str:
        """Which demonstration is learnt from and why, empty before the choice."""
        return self._choice

    @property
    def used(self) -> int:
        """Rollouts used of the budget."""
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
        """Why nothing more is learnt, empty while learning; re-tests may be outstanding."""
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
        """The policy to save as the best so far, None before a usable noise-free run.

        Only noise-free runs count: reproductions, means and re-tests, never an exploring rollout
        that was lucky. While learning: of the chosen demonstration's policies the one of highest
        mean return less `return_noise` / sqrt(runs), the later one of equals. Once the session has
        stopped: its answer.
        """
        noise = self.settings.return_noise
        known = [
            evidence
            for evidence in evidence_of(self._records)
            if self._demonstration in (None, evidence.demonstration)
        ]
        if not known:
            return None
        answers = [e for e in known if self._answer is not None and (e.z == self._answer).all()]
        if answers:
            best, rule = answers[0], f"the answer: {self._stopped}"
        else:
            best = max(reversed(known), key=lambda evidence: evidence.lower_bound(noise))
            rule = f"lower bound {best.lower_bound(noise):.3f}, highest of {len(known)} policies"
        policy, _ = self._parameters[best.demonstration].policy(best.z, best.id)
        runs = len(best.returns)
        why = (
            f"{best.id}: {best.successes} of {runs} noise-free runs succeeded, "
            f"mean return {np.mean(best.returns):.3f}; {rule}"
        )
        return Best(policy, tuple(best.returns), best.successes, why)

    def next_trial(self) -> Trial | None:
        """Rollout to execute now, the same until it is learnt from; None when finished."""
        return self._next_trial(None)

    def _next_trial(self, redrawn: int | None) -> Trial | None:
        """The next trial; `redrawn` is known when it is replayed."""
        if self._pending is None and not self.finished:
            kind, demonstration, z, attempt, redrawn, why = self._plan(redrawn)
            number = len(self._records) + 1
            id = f"trial-{number:04d}"
            parameters = self._parameters[demonstration]
            policy, z = parameters.policy(z, id)
            theta = parameters.theta(z)
            z.setflags(write=False)
            theta.setflags(write=False)
            self._pending = Trial(
                number, id, kind, demonstration, policy, z, theta, attempt, redrawn, why
            )
        return self._pending

    def learn(
        self,
        trial: Trial,
        pan: EndEffectorPath,
        pancake: BodyPath,
        *,
        fault: Fault | None = None,
        bag: str = "",
        truth: Mapping[str, Any] | None = None,
        clock: Mapping[str, Any] | None = None,
    ) -> Record:
        """Judge the executed trial and learn from it.

        Args:
            trial: what `next_trial` gave.
            pan: path of the pan in the base frame.
            pancake: path of the pancake in the base frame.
            fault: the controller's fault if it ended the rollout, else None.
            bag: name of the rollout's bag.
            truth: the stand-in's own account, logged only.
            clock: wall-clock figures, logged only.

        Returns:
            What is to be appended to the log before the next trial.

        Raises:
            ValueError: not the trial that is due, or a path of another rollout.
        """
        for name, path in (("pan", pan), ("pancake", pancake)):
            if path.id != trial.id:
                raise ValueError(f"{name} path is of rollout {path.id!r}, expected {trial.id!r}")
        assessment = assess(trial.policy, pan, pancake, self.settings, fault)
        text = "" if fault is None else fault.text
        return self.note(trial, assessment, fault=text, bag=bag, truth=truth, clock=clock)

    def note(
        self,
        trial: Trial,
        assessment: Assessment,
        *,
        fault: str = "",
        bag: str = "",
        truth: Mapping[str, Any] | None = None,
        clock: Mapping[str, Any] | None = None,
    ) -> Record:
        """Like `learn`, with the rollout judged elsewhere: for skills other than the pancake.

        Raises:
            ValueError: not the trial that is due, or a return that cannot be learnt from.
        """
        if self._pending is None or trial.id != self._pending.id:
            due = None if self._pending is None else self._pending.id
            raise ValueError(f"rollout {trial.id!r} is not the one that is due ({due})")
        trial = self._pending
        learnt, learnt_as = assessment.ret is not None and trial.kind != "retest", None
        if learnt:
            parameters = self._parameters[trial.demonstration]
            learnt_as = corrected(trial, assessment, parameters, self.settings, self._forbidden)
        why = assessment.why
        if trial.kind == "retest" and not why:
            why = "a re-test is not learnt from"
        record = Record(
            number=trial.number,
            id=trial.id,
            kind=trial.kind,
            demonstration=trial.demonstration,
            attempt=trial.attempt,
            redrawn=trial.redrawn,
            z=trial.z.tolist(),
            theta=trial.theta.tolist(),
            learnt=learnt,
            learnt_as=None if learnt_as is None else learnt_as.tolist(),
            ret=None if assessment.ret is None else float(assessment.ret),
            terms=plain(assessment.terms),
            success=bool(assessment.success),
            why=why,
            note="",
            flight=None if assessment.flight is None else plain(assessment.flight),
            fault=fault,
            generator=generator_state(self._rng),
            bag=bag,
            truth=None if truth is None else plain(truth),
            clock=plain(clock or {}),
        )
        return self._take_up(record.model_copy(update={"note": self._follow(record)}))

    def rate(
        self, amount: float, number: int | None = None, clock: Mapping[str, Any] | None = None
    ) -> Rating:
        """Take a person's word that a rollout was worth more, or less, than its return.

        Args:
            amount: to be added to its return; several ratings of a rollout add up.
            number: of the rollout, the last finished one when omitted.
            clock: wall-clock figures, logged only.

        Returns:
            What is to be appended to the log before anything else.

        Raises:
            ValueError: not a rating, no such rollout, one that is not learnt from, or nothing is
                learnt any more.
        """
        if not (np.isfinite(amount) and 0.0 < abs(amount) <= RATING_MAX):
            raise ValueError(f"a rating must be within ±{RATING_MAX} and not 0, got {amount}")
        self._check_still_learning()
        if not self._records:
            raise ValueError("there is no finished rollout to rate yet")
        number = len(self._records) if number is None else number
        if not 1 <= number <= len(self._records):
            raise ValueError(f"rollout {number} is not one of the {len(self._records)} on record")
        record = self._records[number - 1]
        if record.worth is None:
            raise ValueError(f"{record.id} has no return and is not learnt from: {record.why}")
        waiting = [e for e in self._events if isinstance(e, Rating) and e.rollout == number]
        so_far = (record.adjustment or 0.0) + sum(event.amount for event in waiting)
        before, after = (max((record.ret or 0.0) + part, 0.0) for part in (so_far, so_far + amount))
        note = f"{record.id} {'rewarded' if amount > 0.0 else 'punished'}: "
        return self._accept(
            Rating(
                after=self._effective,
                rollout=number,
                amount=float(amount),
                note=f"{note}return {before:.3f} -> {after:.3f}",
                clock=plain(clock or {}),
            )
        )

    def give(self, policy: Policy, bag: str = "", clock: Mapping[str, Any] | None = None) -> Given:
        """Take up a further demonstration: its policy is reproduced next.

        Args:
            policy: fitted to the demonstration, with an id of its own.
            bag: the demonstration, logged only.
            clock: wall-clock figures, logged only.

        Returns:
            What is to be appended to the log before anything else.

        Raises:
            ValueError: the id is taken, the policy does not have the parameters that are learnt,
                the arm must not try it, or nothing is learnt any more.
        """
        self._check_still_learning()
        check_id(policy.id)
        if policy.id in [candidate.id for candidate in self.candidates]:
            raise ValueError(f"there is a demonstration {policy.id!r} already")
        if why := self._forbidden(reproduced(policy, self.settings)):
            raise ValueError(f"the arm must not try {policy.id}: {why}")
        return self._accept(
            Given(
                after=self._effective,
                id=policy.id,
                policy=json.loads(to_json(policy)),
                bag=bag,
                note=f"{policy.id} is reproduced after rollout {self._effective}"
                + (f": {bag}" if bag else ""),
                clock=plain(clock or {}),
            )
        )

    def replay(self, line: Line) -> None:
        """Take up a line of a log as if it had just been made.

        A record's figures are used, so a log goes on where it was even where another processor
        would have rounded its last digit differently.

        Raises:
            ValueError: it is not what comes next in this session.
        """
        if isinstance(line, Record):
            self._replay(line)
            return
        if line.after not in (len(self._records), len(self._records) + 1):
            raise ValueError(
                f"a line after record {len(self._records)} cannot take effect "
                f"after record {line.after}"
            )
        if isinstance(line, Rating) and line.rollout > len(self._records):
            raise ValueError(f"rollout {line.rollout} was rated before it was on record")
        self._accept(line)

    def _replay(self, record: Record) -> None:
        trial = self._next_trial(record.redrawn)
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
        self._follow(record)
        self._take_up(record)

    def _take_up(self, record: Record) -> Record:
        """Close the trial: only now does what a person did meanwhile take effect."""
        self._records[-1] = record
        self._log.append(record)
        events, self._events = self._events, []
        for event in events:
            self._apply(event)
        return record

    @property
    def _effective(self) -> int:
        """Number of rollouts after which what a person does now takes effect."""
        return len(self._records) + (self._pending is not None)

    def _check_still_learning(self) -> None:
        if self._stopped:
            raise ValueError(f"nothing is learnt any more: {self._stopped}")

    def _accept(self, event: E) -> E:
        self._log.append(event)
        if event.after == len(self._records):
            self._apply(event)
        else:
            self._events.append(event)
        return event

    def _apply(self, event: Event) -> None:
        if self._stopped:  # by the very rollout that was under way when it came
            return
        if isinstance(event, Given):
            policy = event.candidate()
            self._parameters[policy.id] = flip_parametrization(
                policy, self.settings.variant, self.settings.noise
            )
            self._candidates.append(policy)
            return
        record = self._records[event.rollout - 1]
        total = (record.adjustment or 0.0) + event.amount
        record = record.model_copy(update={"adjustment": total})
        self._records[event.rollout - 1] = record
        if self._learner is not None:
            self._learner = self._taught_again()
        if not record.succeeded:
            self._confirmation.forget(record)

    def _taught_again(self) -> Power:
        """A learner that was told all rollouts of the demonstration in their order."""
        learner = Power(
            self._parameters[str(self._demonstration)].size, self.settings.power, self._rng
        )
        for record in self._records:
            if record.demonstration == self._demonstration and record.learnt_as is not None:
                learner.tell(np.array(record.learnt_as), float(record.worth or 0.0))
        return learner

    def _plan(self, redrawn: int | None) -> tuple[Kind, str, np.ndarray, int, int, str]:
        """Kind, demonstration, z, attempt, redraws and purpose of the next trial."""
        if self._retry is not None:
            retry = self._retry
            why = f"attempt {retry.attempt}: {retry.why}"
            return retry.kind, retry.demonstration, retry.z, retry.attempt, 0, why
        if len(self._reproductions) < len(self._candidates):
            candidate = self._candidates[len(self._reproductions)]
            zero = np.zeros(self._parameters[candidate.id].size)
            return "reproduction", candidate.id, zero, 1, 0, f"reproduces {candidate.id}"
        learner, permission = self._learner, self._permission
        if learner is None or permission is None or self._demonstration is None:
            raise ValueError("a session that never chose a demonstration is over")
        ran = self._best_without_fault(learner.size)
        kind: Kind = "mean"
        if self._answer is not None:
            kind = "retest"
            z, redrawn = permission.drawn_back(self._answer, ran, redrawn)
            self._answer = z
            why = f"re-test {self._retested + 1} of {self.settings.retests}"
        elif self._confirmation.z is not None:
            z, redrawn = self._confirmation.z, 0
            why = f"confirms a mean, {self._confirmation.count + 1} of {self.settings.confirm}"
        elif self._confirmation.wanted or self._is_mean_turn():
            z, redrawn = permission.drawn_back(learner.mean, ran, redrawn)
            why = "the mean, without noise"
        else:
            kind = "explore"
            z, redrawn = permission.sample(learner, ran, redrawn)
            why = f"explores about the mean with noise {learner.noise:.2f}"
        return kind, self._demonstration, z, 1, redrawn, why

    def _best_without_fault(self, size: int) -> np.ndarray:
        """The z of the rollout that was worth most; 0 if each had a fault."""
        ran = [
            record
            for record in self._records
            if record.demonstration == self._demonstration
            and record.worth is not None
            and not record.fault
        ]
        return np.array(max(ran, key=lambda record: record.worth).z) if ran else np.zeros(size)

    def _is_mean_turn(self) -> bool:
        every = self.settings.mean_every
        return every > 0 and (self._practised + 1) % every == 0

    def _follow(self, record: Record) -> str:
        """Bring everything up to date with a record, live or replayed; says what was decided."""
        self._pending = None
        self._records.append(record)
        z = np.array(record.z)
        if record.ret is None and record.attempt < self.settings.attempts:
            attempt = record.attempt + 1
            self._retry = Retry(record.kind, record.demonstration, z, attempt, record.why)
            return f"not learnt from ({record.why}), tried again"
        self._retry = None
        if record.kind == "retest":
            self._retested += 1
            return "" if record.ret is not None else "dropped"
        self._used += record.ret is not None
        if record.kind == "reproduction":
            note = self._follow_reproduction(record)
        else:
            note = self._practise(record, z)
        if self._learner is not None and not self._stopped:
            known = self._confirmation.z
            answer = self._learner.mean if known is None else known
            limit = 3 * self.settings.budget
            if self._used >= self.settings.budget:
                self._stop(answer, f"budget of {self.settings.budget} rollouts used")
            elif len(self._records) >= limit:
                self._stop(answer, f"{limit} rollouts, of which only {self._used} were usable")
        return "; ".join(part for part in (note, self._stopped) if part)

    def _follow_reproduction(self, record: Record) -> str:
        self._reproductions.append(record.number)
        if self._learner is not None:
            return self._compare(record)
        if len(self._reproductions) < len(self._candidates):
            return ""
        reproductions = [self._records[number - 1] for number in self._reproductions]
        try:
            index, why = choose_demonstration(reproductions, self.settings)
        except ValueError as error:
            self._stopped = str(error)
            return ""
        self._learn_from(reproductions[index].demonstration, why)
        return self._choice

    def _compare(self, record: Record) -> str:
        """Learn from a demonstration that was given later, if it is the better one."""
        recent = [
            float(other.worth)
            for other in self._records
            if other.demonstration == self._demonstration and other.worth is not None
        ][-_RECENT:]
        level = float(np.mean(recent))
        if record.ret is None or record.fault:
            return f"goes on with {self._demonstration}: {record.why}"
        compared = f"return {record.ret:.3f} against {level:.3f} of the last {len(recent)}"
        if record.ret <= level:
            return f"goes on with {self._demonstration}: {compared}"
        self._confirmation = Confirmation(self.settings)  # the old one's is of no use
        self._learn_from(record.demonstration, f"{compared}, from {self._demonstration}")
        return self._choice

    def _learn_from(self, demonstration: str, why: str) -> None:
        self._demonstration = demonstration
        self._choice = f"learns from {demonstration}: {why}"
        self._learner = self._taught_again()
        self._permission = Permission(self._parameters[demonstration], self._forbidden)

    def _practise(self, record: Record, z: np.ndarray) -> str:
        """Follow a trial that explored or ran the mean."""
        learner = self._learner
        if learner is None:
            raise ValueError(f"record {record.number}: {record.kind} before the choice")
        self._practised += 1
        if record.learnt_as is not None and record.ret is not None:
            learner.tell(np.array(record.learnt_as), record.ret)
        note = self._confirmation.follow(record)
        if self._confirmation.complete:
            self._stop(z, f"a mean succeeded {self.settings.confirm} times in a row")
        return note or ("" if record.ret is not None else "dropped")

    def _stop(self, answer: np.ndarray, why: str) -> None:
        parameters = self._parameters[str(self._demonstration)]
        self._answer = parameters.clip(answer)
        self._stopped = why
