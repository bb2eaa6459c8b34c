# SPDX-License-Identifier: Apache-2.0
"""The course of a session: which policy is tried next, and what is made of its outcome.

A session reproduces every demonstration once on the arm, chooses the one to learn from by its
reproduction, explores, runs the mean now and then, stops by a rule, and re-tests its answer.
Everything `Practice` knows follows from its candidates, settings, seed and records, so replaying
the records of a log rebuilds it bit for bit. No ROS, no files, no clock.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from wam_power_ros.flight import Flight, observe_flight
from wam_power_ros.parameters import TURN_OF_FLICK, NoiseScales, Parameters
from wam_power_ros.policy import Policy
from wam_power_ros.power import Power, PowerSettings, generator_state
from wam_power_ros.returns import (
    LandingWeights,
    PancakeWeights,
    landing_return,
    pancake_return,
)
from wam_power_ros.rollout import EndEffectorPath, PancakePath

Kind = Literal["reproduction", "explore", "mean", "retest"]
SCHEMA = "wam_power_ros/rollout/1"

_LONGEST_GAP = 0.2  # s without a frame after which a pancake counts as lost: six frames at 30 Hz
_FALLEN = 0.05  # m under the pan's floor: a pancake last seen there was not lost but dropped
_REDRAWS_MAX = 20
_CUT_SHORT = 0.05  # s a path may be shorter than the rollout
# Motion limits as `safety.exceeded` names them: a policy runs into these by itself.
_OWN_FAULT = re.compile(r"\b(joint \d+|tool|elbow|forearm) at .*(limit|workspace)")


class PracticeSettings(BaseModel):
    """Settings of a session; `preset` has the two sets that are used.

    Attributes:
        variant: what of the policy is learnt, see `Parameters`.
        noise: one standard deviation of exploration a group.
        power: settings of the learner.
        ret: return that is learnt from: "eq5" (the paper's Eq. 5) or "landing" (`landing_return`).
        pancake_weights: of Eq. 5.
        landing_weights: of `landing_return`.
        choice: rule that chooses the demonstration, see `choose_demonstration`.
        budget: number of usable rollouts, reproductions included and re-tests not.
        mean_every: every n-th trial of the practice runs the mean; 0: only to confirm a success.
        landing_gain: part of a measured landing error by which a trial's catch shift is moved
            before it is learnt from; 0: none. Needs the variant "planar".
        landing_limit: most the catch shift is moved for one trial [m].
        turn_gain: part of what a trial's rotation lacked of half a turn by which its flick is moved
            before it is learnt from; 0: none. Needs the variant "planar".
        turn_limit: most the flick is moved for one trial [1].
        success_return: return from which a trial is a success; 0: the return does not matter.
        success_angle: rotation in the air from which a trial is a success if it was also caught
            and flipped [rad]; 0: the flip does not matter.
        confirm: runs of one mean that must succeed in a row for the session to stop; 0: never.
        confirm_margin: how much further than `success_angle` these must turn [rad]. Stopping at
            the first streak selects policies that barely succeed; the margin is against that.
        retests: runs of the final answer, not learnt from.
        attempts: how often one policy is tried when nothing can be learnt from its rollouts.
        return_noise: standard deviation of the return of one policy, for `Practice.best`.
        delta_h: height over the pan at which a falling pancake is judged [m].
        settle_time: time a rollout goes on after the movement [s].
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    variant: Literal["full", "diagonal", "symmetric", "attractors", "planar"]
    noise: NoiseScales
    power: PowerSettings
    ret: Literal["eq5", "landing"]
    pancake_weights: PancakeWeights = PancakeWeights()
    landing_weights: LandingWeights = LandingWeights()
    choice: Literal["return", "flick"]
    budget: int = Field(ge=1)
    mean_every: int = Field(ge=0)
    landing_gain: float = Field(ge=0.0, le=1.0)
    landing_limit: float = Field(default=0.25, gt=0.0, le=1.0)
    turn_gain: float = Field(default=0.0, ge=0.0, le=1.0)
    turn_limit: float = Field(default=0.1, gt=0.0, le=1.0)
    success_return: float = Field(ge=0.0, allow_inf_nan=False)
    success_angle: float = Field(ge=0.0, allow_inf_nan=False)
    confirm: int = Field(ge=0)
    confirm_margin: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    retests: int = Field(ge=0)
    attempts: int = Field(default=3, ge=1)
    return_noise: float = Field(default=0.1, ge=0.0, allow_inf_nan=False)
    delta_h: float = Field(default=0.12, gt=0.0, le=1.0)
    settle_time: float = Field(default=1.0, ge=0.0, le=10.0)

    @model_validator(mode="after")
    def _fit_together(self) -> PracticeSettings:
        if max(self.landing_gain, self.turn_gain) > 0.0 and self.variant != "planar":
            raise ValueError(
                f"landing_gain {self.landing_gain} and turn_gain {self.turn_gain} need a catch "
                f"shift and a flick: variant 'planar', not {self.variant!r}"
            )
        if self.confirm > 0 and self.success_return == 0.0 and self.success_angle == 0.0:
            raise ValueError("confirm needs a success_return or a success_angle")
        return self


_PRESETS: dict[str, dict[str, Any]] = {
    "paper": {
        "variant": "full",
        "noise": {"stiffness": 0.1, "attractor": 0.01, "rotation": 0.05, "catch_shift": 0.01},
        "power": {"sigma": 6, "weights": "return", "decay": 1.0},
        "ret": "eq5",
        "choice": "return",
        "budget": 50,
        "mean_every": 0,
        "landing_gain": 0.0,
        "success_return": 0.9,
        "success_angle": 0.0,
        "confirm": 3,
        "retests": 10,
    },
    "flip": {
        "variant": "planar",
        "noise": {"stiffness": 0.16, "attractor": 0.016, "rotation": 0.05, "catch_shift": 0.016},
        "power": {"sigma": 6, "weights": "sharpened", "sharpness": 0.3, "decay": 0.97},
        "ret": "landing",
        "choice": "return",
        "budget": 60,
        "mean_every": 5,
        "landing_gain": 0.7,
        "turn_gain": 0.5,
        "success_return": 0.0,
        "success_angle": math.radians(150.0),
        "confirm": 8,
        "confirm_margin": math.radians(10.0),
        "retests": 10,
    },
}


def preset(name: str, **changes: Any) -> PracticeSettings:  # noqa: ANN401 - checked by the model
    """Settings of a session by name, with some of them changed.

    Args:
        name: "paper" (Eq. 5, full matrices, sigma 6, no decay, stop at R >= .9 reproducibly) or
            "flip" (ours: planar, sharpened weights, landing correction, a true and caught flip).
        **changes: fields of `PracticeSettings`; a mapping for `noise` or `power` changes only the
            fields it names.

    Raises:
        ValueError: unknown name, unknown field or a value out of range.
    """
    if name not in _PRESETS:
        raise ValueError(f"preset {name!r} is not one of {', '.join(_PRESETS)}")
    values = dict(_PRESETS[name])
    for key, value in changes.items():
        if key in ("noise", "power") and isinstance(value, Mapping):
            value = {**values[key], **value}
        values[key] = value
    return PracticeSettings.model_validate(values)


@dataclass(frozen=True)
class Trial:
    """A rollout to be executed.

    Attributes:
        number: position in the session, from 1.
        id: name of the rollout and of its policy, "trial-0007".
        kind: "reproduction" of a demonstration, "explore", "mean" or "retest" (not learnt from).
        demonstration: id of the candidate it starts from.
        policy: what to execute.
        z: coordinates of that policy. Shape (size,)
        theta: the same in their own units. Shape (size,)
        attempt: 1, or more when earlier rollouts of the same z could not be learnt from.
        redrawn: number of samples that were forbidden before this one.
        why: what the trial is for, in words.
    """

    number: int
    id: str
    kind: Kind
    demonstration: str
    policy: Policy
    z: np.ndarray
    theta: np.ndarray
    attempt: int
    redrawn: int
    why: str


@dataclass(frozen=True)
class Assessment:
    """What a rollout was worth.

    Attributes:
        ret: its return, None when nothing can be said (cut short, lost from view).
        terms: terms of the return.
        flight: fields of `Flight`, as data for JSON; None when there was none to observe.
        success: whether it met the session's success rule.
        why: why nothing can be said, or what is remarkable; may be empty.
    """

    ret: float | None
    terms: Mapping[str, float] = field(default_factory=dict)
    flight: Mapping[str, Any] | None = None
    success: bool = False
    why: str = ""


class Record(BaseModel):
    """One executed rollout, a line of the session's log.

    Attributes:
        schema_: version of this layout ("schema" in JSON).
        number, id, kind, demonstration, attempt, redrawn: of the trial.
        z, theta: what was executed, in scaled coordinates and in their own units.
        learnt: whether the learner was or may be told.
        learnt_as: coordinates it is told, landing correction included; None when not learnt.
        ret, terms: return and its terms; `ret` is None when nothing can be said about the rollout.
        success: whether it met the success rule.
        why: why it was not learnt from, or what is remarkable.
        note: what the practice decided after this rollout, in words.
        flight: what the tracker saw, the fields of `Flight` [s, m, rad]; None when nothing.
        fault: the controller's fault, if any.
        generator: state of the random generator after this trial was drawn.
        bag: name of its bag.
        adjustment: a person's correction of the return; nothing makes any yet.
        truth: what really happened, from the stand-in; None on hardware. Never learnt from.
        clock: wall-clock figures; all that differs between two runs of one seed is in here.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    schema_: Literal["wam_power_ros/rollout/1"] = Field(default=SCHEMA, alias="schema")
    number: int = Field(ge=1)
    id: str
    kind: Kind
    demonstration: str
    attempt: int = Field(ge=1)
    redrawn: int = Field(default=0, ge=0)
    z: list[float]
    theta: list[float]
    learnt: bool
    learnt_as: list[float] | None
    ret: float | None = Field(ge=0.0, allow_inf_nan=False)
    terms: dict[str, float | None]
    success: bool
    why: str
    note: str
    flight: dict[str, Any] | None
    fault: str
    generator: dict[str, Any]
    bag: str
    adjustment: dict[str, Any] | None = None
    truth: dict[str, Any] | None
    clock: dict[str, Any]

    @model_validator(mode="after")
    def _fit_together(self) -> Record:
        if self.learnt != (self.learnt_as is not None) or (self.learnt and self.ret is None):
            raise ValueError("learnt goes with learnt_as and a return")
        if len(self.theta) != len(self.z) or len(self.learnt_as or self.z) != len(self.z):
            raise ValueError("z, theta and learnt_as must be equally long")
        if not np.isfinite([*self.z, *self.theta, *(self.learnt_as or [])]).all():
            raise ValueError("z, theta and learnt_as must be finite")
        return self

    def to_json(self) -> str:
        """One line of JSON; floats come back bit for bit."""
        return json.dumps(self.model_dump(mode="json", by_alias=True), allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> Record:
        """Record of a line.

        Raises:
            ValueError: not JSON, or not a record; the message names the field.
        """
        return cls.model_validate(json.loads(text))


@dataclass(frozen=True)
class Best:
    """The policy a session would answer with now.

    Attributes:
        policy: the policy, named after the first trial that ran it.
        returns: returns of its noise-free runs.
        successes: number of these runs that succeeded.
        why: the evidence for it, in words.
    """

    policy: Policy
    returns: tuple[float, ...]
    successes: int
    why: str


@dataclass
class _Evidence:
    """Noise-free runs of one z."""

    id: str
    demonstration: str
    z: np.ndarray
    returns: list[float] = field(default_factory=list)
    successes: int = 0

    def lower_bound(self, return_noise: float) -> float:
        return float(np.mean(self.returns)) - return_noise / math.sqrt(len(self.returns))


@dataclass(frozen=True)
class _Retry:
    kind: Kind
    demonstration: str
    z: np.ndarray
    attempt: int
    why: str


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
    * A mean that succeeds is run again, unchanged, until it fails or has succeeded `confirm` times
      in a row; all these runs are learnt from. Returns are noisy and an elite keeps its lucky
      rollouts for ever; running the mean again is what tells luck from skill.
    * The session stops at that, or when the budget is used. Its answer is the confirmed mean or
      the last one; it is re-tested and not changed any more.
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
            forbidden: why the arm must not try a sampled policy, empty if it may; what is
                forbidden is drawn again. The same policy must always get the same answer.

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
        self._candidates = tuple(candidates)
        self._parameters = {
            policy.id: Parameters(policy, settings.variant, settings.noise) for policy in candidates
        }
        self._rng = np.random.Generator(np.random.PCG64(seed))
        self._records: list[Record] = []
        self._pending: Trial | None = None
        self._retry: _Retry | None = None
        self._reproductions: list[Record] = []
        self._demonstration: str | None = None
        self._choice = ""
        self._learner: Power | None = None
        self._used = 0  # usable rollouts, of the budget
        self._practised = 0  # trials of the practice that are over, dropped ones included
        self._streak: tuple[np.ndarray, int] | None = None  # a mean that succeeds, and how often
        self._mean_wanted = False
        self._evidence: dict[tuple[str, bytes], _Evidence] = {}
        self._stopped = ""
        self._answer: np.ndarray | None = None
        self._retested = 0

    @classmethod
    def from_records(
        cls,
        candidates: Sequence[Policy],
        settings: PracticeSettings,
        seed: int,
        records: Sequence[Record],
        forbidden: Callable[[Policy], str] = lambda policy: "",
    ) -> Practice:
        """Practice as it was after the last of `records`.

        Raises:
            ValueError: the records are not those of such a session; names the first that differs.
        """
        practice = cls(candidates, settings, seed, forbidden)
        for record in records:
            practice.replay(record)
        return practice

    @property
    def records(self) -> tuple[Record, ...]:
        """All rollouts so far, oldest first."""
        return tuple(self._records)

    @property
    def parameters(self) -> Parameters | None:
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
        if not self._evidence:
            return None
        noise = self.settings.return_noise
        answer = None
        if self._answer is not None:
            answer = self._evidence.get((str(self._demonstration), self._answer.tobytes()))
        if answer is not None:
            best, rule = answer, f"the answer: {self._stopped}"
        else:
            known = [
                evidence
                for evidence in self._evidence.values()
                if self._demonstration in (None, evidence.demonstration)
            ]
            if not known:
                return None
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
        pancake: PancakePath,
        *,
        fault: str = "",
        bag: str = "",
        truth: Mapping[str, Any] | None = None,
        clock: Mapping[str, Any] | None = None,
    ) -> Record:
        """Judge the executed trial and learn from it.

        Args:
            trial: what `next_trial` gave.
            pan: path of the pan in the base frame.
            pancake: path of the pancake in the base frame.
            fault: the controller's fault if it ended the rollout, else empty.
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
        return self.note(trial, assessment, fault=fault, bag=bag, truth=truth, clock=clock)

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
        learnt = assessment.ret is not None and trial.kind != "retest"
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
            learnt_as=self._corrected(trial, assessment).tolist() if learnt else None,
            ret=None if assessment.ret is None else float(assessment.ret),
            terms=_plain(assessment.terms),
            success=bool(assessment.success),
            why=why,
            note="",
            flight=None if assessment.flight is None else _plain(assessment.flight),
            fault=fault,
            generator=generator_state(self._rng),
            bag=bag,
            truth=None if truth is None else _plain(truth),
            clock=_plain(clock or {}),
        )
        record = record.model_copy(update={"note": self._follow(record)})
        self._records.append(record)
        return record

    def replay(self, record: Record) -> None:
        """Take up a logged record as if it had just been learnt.

        The record's figures are used, so a log goes on where it was even where another processor
        would have rounded its last digit differently.

        Raises:
            ValueError: the record is not that of the trial that is due.
        """
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
        self._records.append(record)

    def _plan(self, redrawn: int | None) -> tuple[Kind, str, np.ndarray, int, int, str]:
        """Kind, demonstration, z, attempt, redraws and purpose of the next trial."""
        if self._retry is not None:
            retry = self._retry
            why = f"attempt {retry.attempt}: {retry.why}"
            return retry.kind, retry.demonstration, retry.z, retry.attempt, 0, why
        if self._learner is None or self._demonstration is None:
            candidate = self._candidates[len(self._reproductions)]
            zero = np.zeros(self._parameters[candidate.id].size)
            return "reproduction", candidate.id, zero, 1, 0, f"reproduces {candidate.id}"
        kind: Kind = "explore"
        if self._answer is not None:
            kind, z = "retest", self._answer
            why = f"re-test {self._retested + 1} of {self.settings.retests}"
        elif self._streak is not None:
            kind, z = "mean", self._streak[0]
            why = f"confirms a mean, {self._streak[1] + 1} of {self.settings.confirm}"
        elif self._mean_wanted or self._is_mean_turn():
            kind, z, why = "mean", self._learner.mean, "the mean, without noise"
        else:
            why = f"explores about the mean with noise {self._learner.noise:.2f}"
            z, redrawn = self._sample(self._learner, self._parameters[self._demonstration], redrawn)
            return kind, self._demonstration, z, 1, redrawn, why
        return kind, self._demonstration, z, 1, 0, why

    def _sample(
        self, learner: Power, parameters: Parameters, redrawn: int | None
    ) -> tuple[np.ndarray, int]:
        """A sample that is not forbidden, and how many were; the last one if all are."""
        last = _REDRAWS_MAX if redrawn is None else redrawn
        for count in range(last + 1):
            z = learner.ask()
            if redrawn is None and count < last:
                if not self._forbidden(parameters.policy(z, "sample")[0]):
                    break
        return z, count

    def _is_mean_turn(self) -> bool:
        every = self.settings.mean_every
        return every > 0 and (self._practised + 1) % every == 0

    def _corrected(self, trial: Trial, assessment: Assessment) -> np.ndarray:
        """The trial's z with its catch shift and its flick moved by what landing and turn missed.

        The catch shift goes to where the pancake came down, the flick to where it would have made
        half a turn: errors with a direction, which a return does not have.
        """
        settings, flight = self.settings, assessment.flight
        if not (settings.landing_gain or settings.turn_gain):
            return trial.z
        if flight is None or not (flight["tossed"] and flight["seen"]):
            return trial.z
        shift = settings.landing_gain * float(flight["landing_error"][0])  # along x
        flick = settings.turn_gain * (math.pi - float(flight["angle"])) / TURN_OF_FLICK
        parameters = self._parameters[trial.demonstration]
        moved = np.zeros(parameters.size)
        for group, value, limit in (
            ("catch_shift", shift, settings.landing_limit),
            ("flick", flick, settings.turn_limit),
        ):
            index = parameters.groups[group]
            moved[index] = float(np.clip(value, -limit, limit)) / parameters.scale[index]
        for share in (1.0, 0.5, 0.25):  # not to where the arm cannot follow
            z = trial.z + share * moved
            if not self._forbidden(parameters.policy(z, "corrected")[0]):
                return z
        return trial.z

    def _follow(self, record: Record) -> str:
        """Bring everything up to date with a record, live or replayed; says what was decided."""
        self._pending = None
        z = np.array(record.z)
        if record.ret is None and record.attempt < self.settings.attempts:
            attempt = record.attempt + 1
            self._retry = _Retry(record.kind, record.demonstration, z, attempt, record.why)
            return f"not learnt from ({record.why}), tried again"
        self._retry = None
        if record.ret is not None and record.kind != "explore":
            key = (record.demonstration, z.tobytes())
            default = _Evidence(record.id, record.demonstration, z)
            evidence = self._evidence.setdefault(key, default)
            evidence.returns.append(record.ret)
            evidence.successes += record.success
        if record.kind == "retest":
            self._retested += 1
            return "" if record.ret is not None else "dropped"
        self._used += record.ret is not None
        if record.kind == "reproduction":
            self._reproductions.append(record)
            if len(self._reproductions) == len(self._candidates):
                self._choose()
                return f"{self._choice}{self._stopped}"
            return ""
        return self._practise(record, z)

    def _choose(self) -> None:
        try:
            index, why = choose_demonstration(self._reproductions, self.settings)
        except ValueError as error:
            self._stopped = str(error)
            return
        record = self._reproductions[index]
        self._demonstration = record.demonstration
        self._choice = f"learns from {record.demonstration}: {why}"
        parameters = self._parameters[record.demonstration]
        self._learner = Power(parameters.size, self.settings.power, self._rng)
        self._learner.tell(np.array(record.learnt_as), float(record.ret or 0.0))

    def _practise(self, record: Record, z: np.ndarray) -> str:
        """Follow a trial that explored or ran the mean."""
        settings, learner = self.settings, self._learner
        if learner is None:
            raise ValueError(f"record {record.number}: {record.kind} before the choice")
        self._practised += 1
        if record.learnt_as is not None and record.ret is not None:
            learner.tell(np.array(record.learnt_as), record.ret)
        note = "" if record.ret is not None else "dropped"
        if settings.confirm > 0:
            if record.kind == "mean":
                self._mean_wanted = False
                before = 0 if self._streak is None else self._streak[1]
                good = record.success and self._has_margin(record)
                self._streak = (z, before + 1) if good else None
                if good:
                    note = f"{before + 1} of {settings.confirm} successes in a row"
                    if before + 1 == settings.confirm:
                        self._stop(z, f"a mean succeeded {settings.confirm} times in a row")
                elif before > 0:
                    note = f"ended after {before} successes in a row"
            elif record.success and settings.mean_every == 0:
                self._mean_wanted = True
                note = "a success: the mean is run to confirm it"
        if not self._stopped:
            answer = learner.mean if self._streak is None else self._streak[0]
            limit = 3 * settings.budget
            if self._used >= settings.budget:
                self._stop(answer, f"budget of {settings.budget} rollouts used")
            elif len(self._records) + 1 >= limit:
                self._stop(answer, f"{limit} rollouts, of which only {self._used} were usable")
        return "; ".join(part for part in (note, self._stopped) if part)

    def _has_margin(self, record: Record) -> bool:
        settings = self.settings
        if settings.success_angle == 0.0 or settings.confirm_margin == 0.0:
            return True
        turned = abs((record.flight or {}).get("angle", 0.0))
        return turned >= settings.success_angle + settings.confirm_margin

    def _stop(self, answer: np.ndarray, why: str) -> None:
        parameters = self._parameters[str(self._demonstration)]
        self._answer = parameters.clip(answer)
        self._stopped = why


def choose_demonstration(
    reproductions: Sequence[Record], settings: PracticeSettings
) -> tuple[int, str]:
    """Which of the reproduced demonstrations to learn from.

    The authors chose one good demonstration of a small series; good is here how it reproduces.

    * "return": the highest return.
    * "flick": of those that tossed the pancake, the one nearest to a toss that is good to learn
      from: turned by at least 85 degrees (over 100 there is less left to learn but more speed is
      used up), at least .35 m high, and coming down .10 to .18 m outward of the pan. One that falls
      short makes the pan chase back under it. Missing a range by 15 degrees, .1 m of height or
      .05 m of landing costs one each, half as much for turning too far. If none tossed: the
      highest return.

    Args:
        reproductions: one record for each candidate; those without a return or with a fault are
            not eligible.
        settings: `choice` names the rule.

    Returns:
        Index into `reproductions`, the first of equals, and the reason in words.

    Raises:
        ValueError: none is eligible.
    """
    eligible = [
        index
        for index, record in enumerate(reproductions)
        if record.ret is not None and not record.fault
    ]
    if not eligible:
        reasons = "; ".join(f"{record.demonstration}: {record.why}" for record in reproductions)
        raise ValueError(f"no demonstration could be reproduced ({reasons})")
    of = f"of {len(reproductions)}"
    tossed = [index for index in eligible if (reproductions[index].flight or {}).get("tossed")]
    if settings.choice == "return" or not tossed:
        best = max(eligible, key=lambda index: float(reproductions[index].ret or 0.0))
        rule = "highest return" if settings.choice == "return" else "none tossed; highest return"
        return best, f"{rule} {of} reproductions, {reproductions[best].ret:.3f}"
    best = min(tossed, key=lambda index: _distance_from_flick(reproductions[index].flight or {}))
    flight = reproductions[best].flight or {}
    return best, (
        f"its reproduction is the nearest to a good toss {of}: "
        f"{math.degrees(abs(flight['angle'])):.0f} deg, {flight['apex']:.2f} m high, "
        f"{flight['landing_error'][0]:+.2f} m outward of the pan; "
        f"cost {_distance_from_flick(flight):.1f}"
    )


def _distance_from_flick(flight: Mapping[str, Any]) -> float:
    angle, apex = math.degrees(abs(flight["angle"])), flight["apex"]
    outward, sideways, _ = flight["landing_error"]
    return (
        max(85.0 - angle, 0.0) / 15.0
        + max(angle - 100.0, 0.0) / 30.0
        + max(0.35 - apex, 0.0) / 0.1
        + max(0.10 - outward, outward - 0.18, 0.0) / 0.05
        + abs(sideways) / 0.05
    )


def assess(
    policy: Policy,
    pan: EndEffectorPath,
    pancake: PancakePath,
    settings: PracticeSettings,
    fault: str = "",
) -> Assessment:
    """Return and success of a rollout, or why nothing can be said about it.

    Args:
        policy: what was executed.
        pan: path of the pan in the base frame.
        pancake: path of the pancake in the base frame.
        settings: see there.
        fault: the controller's fault if it ended the rollout, else empty.
    """
    if fault:
        if _OWN_FAULT.search(fault):
            return Assessment(0.0, why=f"{fault}: counts as return 0")
        return Assessment(None, why=fault)
    duration = policy.basis.duration + settings.settle_time
    if len(pan.t) == 0 or pan.t[-1] < duration - _CUT_SHORT:
        end = pan.t[-1] if len(pan.t) else 0.0
        return Assessment(None, why=f"cut short at {end:.2f} s of {duration:.2f} s")
    if len(pancake.t) == 0:
        return Assessment(None, why="the pancake was never seen")
    flight = observe_flight(pan, pancake, settings.delta_h)
    summary = _plain(dataclasses.asdict(flight))
    lost = _lost_from_view(pan, pancake, flight)
    if lost:
        return Assessment(None, flight=summary, why=lost)
    if settings.ret == "eq5":
        result = pancake_return(flight, settings.pancake_weights)
    else:
        result = landing_return(flight, settings.landing_weights)
    success = result.total >= settings.success_return and (
        settings.success_angle == 0.0
        or bool(flight.resting and flight.flipped and abs(flight.angle) >= settings.success_angle)
    )
    return Assessment(result.total, result.terms, summary, success)


def _lost_from_view(pan: EndEffectorPath, pancake: PancakePath, flight: Flight) -> str:
    """Why the pancake was not seen well enough to judge the rollout, empty when it was."""
    end = float(pan.t[-1])
    seen = np.clip(np.concatenate([[0.0], pancake.t]), 0.0, end)
    needed = min(flight.t_f, end) if flight.tossed else end
    gaps = np.diff(seen)
    late = np.flatnonzero((gaps > _LONGEST_GAP) & (seen[:-1] < needed))
    if len(late):
        at = seen[late[0]]
        return f"the pancake was lost from view for {gaps[late[0]]:.2f} s from {at:.2f} s on"
    if flight.tossed and not flight.seen:
        return "the pancake was not seen coming down"
    if end - seen[-1] > _LONGEST_GAP:
        height = pancake.position[-1, 2] - np.interp(seen[-1], pan.t, pan.position[:, 2])
        if height > -_FALLEN:
            return f"the pancake was lost from view at {seen[-1]:.2f} s, not having fallen"
    return ""


def _plain(value: Any) -> Any:  # noqa: ANN401 - JSON is any of its types
    """The same as data for JSON; what is not finite becomes None."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
