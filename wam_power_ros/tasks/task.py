# SPDX-License-Identifier: Apache-2.0
"""Base of a task: everything that a session needs to know about one skill.

A class derived from `Task` is found by its entry point in the group `wam_power_ros.tasks`, so a
laboratory can keep its task in a package of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from numbers import Real
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Protocol

import numpy as np
from pydantic import BaseModel

from wam_power_ros.faults import Fault
from wam_power_ros.learning.demonstration import Demonstration, ToolPose, from_joint_samples
from wam_power_ros.learning.dmp import FitSettings, fit
from wam_power_ros.learning.learner import ErrorModel
from wam_power_ros.learning.model_based import UNKNOWN_ERROR
from wam_power_ros.learning.parametrization import Parametrization, parametrization_of
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Rollout, SimulatedRollout
from wam_power_ros.regions import Region
from wam_power_ros.tasks.errors import KNOWN, Effect, Error, RoughErrors, learnt, predictor, told
from wam_power_ros.tasks.heading import turned
from wam_power_ros.tasks.reset import Action, BodyState
from wam_power_ros.tasks.settings import FIT, TaskSettings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from wam_power_ros.tasks.errors import Simulate

UNSEEN_MAX = 0.25  # time at the end of a rollout in which the body must have been seen [s]
MISSING_MAX = 0.05  # largest missing part at the end of a path that counts as complete [s]


@dataclass(frozen=True)
class Assessment:
    """Return and success of one rollout."""

    ret: float | None  # return, at least 0; None if the policy cannot be judged by this rollout
    terms: Mapping[str, float] = field(default_factory=dict)  # of the return, by name
    # What was measured of the rollout, as JSON data; None if nothing
    observation: Mapping[str, Any] | None = None
    success: bool = False  # whether it met the success criterion of the task
    why: str = ""  # reason for a missing return, or a remark


class Pose(NamedTuple):
    """Pose of a frame in the base frame."""

    position: np.ndarray  # (3,) [m]
    rotation: np.ndarray  # (3, 3)


class LoggedRollout(Protocol):
    """Logged rollout as far as a task may use it; for what has no comment see `Assessment`."""

    kind: Literal["reproduction", "explore", "mean", "retest"]
    ret: float | None
    observation: Mapping[str, Any] | None
    success: bool
    why: str
    fault: str  # that ended it; "" without
    truth: Mapping[str, Any] | None  # of the simulator; None on a real arm


@dataclass(frozen=True)
class Goal:
    """What a task is to achieve, in the words of its reports."""

    achieved: str = "succeeded"  # completes "Rollout 2 was the first that ..."
    first: str = "first success"  # mark of that rollout in a figure
    retests: str = "that succeeded"  # completes "re-tests ..."
    question: str = ""  # completes "...: measurements and ground truth agree"; "" for none
    observed: str = ""  # key of its answer in the observation of a rollout
    true: str = ""  # key of its answer in the ground truth of a rollout


class Task:
    """One skill under one set of settings; derive from it.

    A task has a `name`, and says what is learnt: `errors`, the `effects` that move them, and
    `observe`, which measures them; or `assess` alone, the return. All else has a default.

    Attributes:
        name: Name of the task, as in `--task NAME`.
        rated: Whether a session asks a person to rate each rollout that runs to its end, and
            learns from that alone.
        body: Name of the tracked rigid body, which its topics contain; "" for none.
        single_policy: Whether one policy is fitted to all demonstrations; otherwise one to each,
            and learning starts from the one that reproduces best.
        fit_settings: How a demonstration is cut out of a recording, and a policy fitted to it.
        Settings: Model of `settings`; frozen, unknown fields refused.
        presets: Name -> settings of a session: fields of `Settings`, fields of
            `practice.settings.PracticeSettings`, and `learner`, a mapping with a learner's name and
            settings. What is left out has its default. The first preset is the default.
        errors: Errors that a rollout measures, see `observe`; empty for a task that is learnt from
            returns alone. So is a class that overrides `assess` and states no errors of its own.
        effects: Rough change of the errors by learnt parameters; learners correct and plan by it.
        targets: Numbers that a session's goal may state, by name, with those that it states under
            the key "goal" of `context`. An error of that name is measured from its target; NaN: it
            does not count unless the goal states one.
        rest_time: Time for which the body must have been `ready` before a rollout [s].
        goal: What is to be achieved, in the words of the reports.
        settle_time: Time that a rollout continues after the movement [s].
        gain: Share of a measured error by which a rollout is corrected in hindsight; 0 for none.
        region: Guarded region at which the controller ends its rollouts, None for none.
        heading: Direction of a planar movement about the vertical [rad], if `context` has one.

    A task is constructed from its settings and from `context`: the session stores what `context_of`
    derives from the demonstrations at its start.
    """

    name: ClassVar[str]
    rated: ClassVar[bool] = False
    body: ClassVar[str] = ""
    single_policy: ClassVar[bool] = False
    fit_settings: ClassVar[FitSettings] = FIT
    Settings: ClassVar[type[BaseModel]] = TaskSettings
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"default": {}}
    errors: ClassVar[Sequence[Error]] = ()
    effects: ClassVar[Sequence[Effect]] = ()
    targets: Mapping[str, float] = MappingProxyType({})
    rest_time: float = 0.0
    goal: ClassVar[Goal] = Goal()
    gain: float = 0.5
    region: Region | None = None

    def __init_subclass__(cls) -> None:
        """Refuse a class that cannot work, or a part of it that does nothing."""
        if fault := next(cls._faults(), ""):
            raise TypeError(f"task {cls.__qualname__}: {fault}")

    @classmethod
    def _faults(cls) -> Iterator[str]:
        """What is wrong with the class: the values, and what is allowed."""
        members = {*vars(Task), *Task.__annotations__}
        for own in [each for each in vars(cls) if each[0] != "_" and each not in members]:
            if own in ("settings", "settle_time"):
                yield f"{own} is stated by `Settings`"
            elif meant := get_close_matches(own, members, 1, 0.8):
                yield f"it has no member {own!r}: {meant[0]!r} is meant, or choose another name"
        for key, default in (("name", ""), ("body", "none")):  # which name files and topics
            if not str((value := getattr(cls, key, "")) or default).isidentifier():
                yield f"{key} = {value!r} must be a name of letters, digits and _"
        presets = cls.presets if isinstance(cls.presets, Mapping) else {}
        if not (presets and all(isinstance(each, Mapping) for each in presets.values())):
            yield f"presets = {cls.presets!r} must be a mapping of names to mappings of settings"
        if getattr(cls.Settings, "model_config", {}).get("extra") != "forbid":
            yield f"{cls.Settings} must refuse unknown fields: ConfigDict(extra='forbid')"
        needed = {"settle_time"}
        needed |= {"variant", "noise"} if cls.parametrization is Task.parametrization else set()
        if missing := sorted(needed - cls.Settings.model_fields.keys()):
            yield f"{cls.Settings} has no {', '.join(missing)}: derive it from TaskSettings"
        for key, kind in (("errors", Error), ("effects", Effect)):
            value = getattr(cls, key)
            if not (isinstance(value, Sequence) and all(isinstance(e, kind) for e in value)):
                yield f"{key} = {value!r} must be a tuple of {kind.__name__}, such as (one,)"
        names = [error.name for error in cls.errors]
        stated = [*names, *((effect.group, effect.place) for effect in cls.effects)]
        for twice in [each for each in stated if stated.count(each) > 1]:
            yield f"{twice!r} is stated twice"
        limits = [error.limit for error in cls.errors if error.limit < math.inf]
        if cls.assess is Task.assess and (cls.observe is Task.observe or not limits):
            yield "there is no return: define observe, and an error with a limit; or define assess"
        groups = {effect.group for effect in cls.effects} - {*KNOWN}
        if groups and cls.parametrization is Task.parametrization:
            known = f"{', '.join(KNOWN)}, and there is no parametrization of its own"
            yield f"effect {min(groups)!r} is not one of {known}"
        moved = {name for effect in cls.effects for name in effect.moves}
        if "effects" in vars(cls) and (unknown := moved - {*names}):
            yield f"effects move {min(unknown)!r}, which is none of the errors {', '.join(names)}"
        for error in cls.errors:
            if error.name not in moved and error.limit == math.inf:
                only = ", ".join(sorted(moved)) or "nothing"
                yield f"error {error.name!r} has no limit, and effects move only {only}"
        if "predict" in vars(cls) and not moved & {*names}:
            yield "predict is never asked: effects move none of the errors"
        targets = vars(cls).get("targets", {}).keys() - {*names}
        if targets and cls.carried is Task.carried:
            yield f"target {min(targets)!r} is none of the errors, and there is no `carried`"
        if not 0.0 <= cls.gain <= 1.0:
            yield f"gain = {cls.gain} must be 0 to 1"

    def __init__(self, settings: Any, context: Mapping[str, Any]) -> None:  # noqa: ANN401
        """Construct the task; see the class."""
        self.settings = settings
        self.settle_time: float = settings.settle_time
        self.targets = {**self.targets, **context.get("goal", {})}
        self.heading = float(context.get("heading", 0.0))

    @classmethod
    def declares(cls, *names: str) -> bool:
        """Whether one of these is of the same class as `assess`, or of one derived from it."""
        last = next(each for each in cls.__mro__ if vars(each).keys() & {"assess", *names})
        return bool(vars(last).keys() & set(names))

    @classmethod
    def learns_from_errors(cls) -> bool:
        """Whether an effect moves an error, and the errors are of its return."""
        return cls.declares("errors") and bool(learnt(cls.errors, cls.effects))

    def wanted_errors(self) -> list[Error]:
        """`errors` that count with these `targets`, each with its own."""
        errors = [replace(e, target=self.targets.get(e.name, 0.0)) for e in self.errors]
        return [error for error in errors if not math.isnan(error.target)]

    def learnt_errors(self) -> list[Error]:
        """Errors that are learnt from: those that an effect moves, if they are of its return."""
        return learnt(self.wanted_errors(), self.effects) if self.declares("errors") else []

    @classmethod
    def demonstration_of(
        cls, arm: ToolPose, stamps_ns: Sequence[int] | np.ndarray, q: np.ndarray
    ) -> Demonstration:
        """Cut the movement out of a recording; see `from_joint_samples`."""
        return from_joint_samples(arm, stamps_ns, q, cls.fit_settings.movement)

    @classmethod
    def policy_of(
        cls, demonstrations: Sequence[Demonstration], policy_id: str, springs: int = 0
    ) -> Policy:
        """Fit a policy, of `springs` spring-dampers if given; a ValueError says why none can be."""
        settings = cls.fit_settings
        if springs:
            settings = replace(settings.with_count(springs), error=math.inf)
        return fit(demonstrations, settings, policy_id)

    @classmethod
    def context_of(
        cls, demonstrations: Sequence[Demonstration], region: Region | None
    ) -> dict[str, Any]:
        """Data that the session stores for the constructor, as JSON data.

        `demonstrations` are all of the session, `region` the controller's guarded one if any.
        """
        return {}

    def carried(self, policy: Policy, former: Mapping[str, float]) -> Policy:
        """Change a policy of other `targets` as far as physics says how, by default not at all.

        What its errors, measured from the new targets, tell is corrected then.
        """
        return policy

    def parametrization(self, policy: Policy) -> Parametrization:
        """Learnt parameters of a policy and their exploration noise.

        By default those of the settings, and one for each of `effects`.
        """
        directions = [effect.direction(policy) for effect in self.effects]
        return parametrization_of(policy, self.settings.variant, self.settings.noise, directions)

    def ready(self, body: BodyState | None, tool: Pose) -> str:
        """Reason why a rollout must not begin yet, for the operator; empty if it may.

        By default it may once the body is seen.

        `body` is None if it is not seen or there is none; `tool` as at the start of the policy.
        """
        return f"the {self.body} is not seen" if self.body and body is None else ""

    def reset(self, body: BodyState | None, arm: ToolPose, q_start: np.ndarray) -> Action:
        """What puts back a body that is not `ready`, where no stand-in resets the scene.

        The arm rests at the start of the policy, with joint angles `q_start` (n,) [rad].

        Returns:
            A movement of the arm; "wait" if the body will come to rest; otherwise "person".
        """
        return "person"

    def observe(self, rollout: Rollout) -> Mapping[str, Any]:
        """Measure a rollout that ran to its end, at which the body was seen.

        Returns:
            Values of `errors` by name, in their units, and whatever else is to be logged, as JSON
            data. What is left out or not finite is unknown; empty if the rollout tells nothing.
        """
        return {}

    def assess(self, policy: Policy, rollout: Rollout) -> Assessment:
        """Return and success of a rollout of `policy`.

        By default the return is 1 / (1 + r), with the root mean square r of `errors` in tolerances,
        `UNKNOWN_ERROR` where unknown: 1 for none, a half at the tolerances, and of two far misses
        more for the nearer one. A success is within all limits.
        """
        if rollout.fault is not None:
            return fault_assessment(rollout.fault)
        if why := cut_short(policy, rollout, self.settle_time) or self._unseen(rollout):
            return Assessment(None, why=why)
        seen = self.observe(rollout)
        if not isinstance(seen, Mapping):
            raise TypeError(f"observe of task {self.name!r} told {seen!r}, must be a mapping")
        measured = self.measure(seen)
        if not measured:
            names = ", ".join(error.name for error in self.errors)
            why = f"observe told {', '.join(seen) or 'nothing'}, no known value of {names}"
            return Assessment(None, observation=seen, why=why)
        wanted = self.wanted_errors()
        error = told(wanted, measured)
        rms = np.sqrt(np.mean(np.nan_to_num(error, nan=UNKNOWN_ERROR) ** 2))
        limits = np.array([each.limit / each.tolerance for each in wanted])
        success = bool(((np.abs(error) < limits) | np.isinf(limits)).all())
        ret = float(1.0 / (1.0 + rms))
        return Assessment(ret, {"errors": ret}, seen, success)

    def _unseen(self, rollout: Rollout) -> str:
        """Why a rollout does not tell where the body ended; empty if it does."""
        if not self.body:
            return ""
        last = -math.inf if rollout.body is None or not len(rollout.body.t) else rollout.body.t[-1]
        late = rollout.tool.t[-1] - last > UNSEEN_MAX
        return f"the {self.body} was not seen at the end" if late else ""

    def error_correction(
        self, assessment: Assessment, parametrization: Parametrization
    ) -> Sequence[np.ndarray]:
        """Shifts of z that would have reduced the measured errors; a rollout is learnt from there.

        Returns:
            Shifts of z, shape (size,) each, one for each effect, empty for no correction; if the
            sum is not feasible, they are applied one after another, each as far as is feasible.
        """
        error, model = self.error(assessment.observation), self.rough_errors(parametrization)
        return () if error is None or model is None else model.correction(error, self.gain)

    @property
    def corrections(self) -> Sequence[str]:
        """Measured errors that `error_correction` corrects with these settings, for the reports."""
        return [error.name for error in self.learnt_errors()] if self.gain else []

    def success_margins(self, record: LoggedRollout) -> Sequence[float]:
        """How far inside each of its limits a rollout was, for the stopping rule.

        It is also asked of rollouts that failed.

        Returns:
            Positive numbers inside, negative ones outside, about normally distributed over rollouts
            of one policy. Empty: not known, so that successes are counted alone. By default those
            of `errors` that have a limit.
        """
        seen = None if record.observation is None else self.measure(record.observation)
        limited = [error for error in self.wanted_errors() if error.limit < math.inf]
        if seen is None or any(error.name not in seen for error in limited):
            return ()
        return [error.limit - abs(seen[error.name] - error.target) for error in limited]

    @property
    def scatter(self) -> Sequence[float]:
        """Standard deviations of `success_margins` to be expected of one policy; empty if unknown.

        In doubt larger ones: the stopping rule counts them as four observations.
        """
        limited = [error.scatter for error in self.wanted_errors() if error.limit < math.inf]
        return limited if all(limited) else ()

    def measure(self, observation: Mapping[str, Any]) -> Mapping[str, float] | None:
        """Values of `errors` by name, as observed; None if the rollout tells nothing."""
        values = {error.name: observation.get(error.name) for error in self.errors}
        for name, value in values.items():
            if not isinstance(value, Real | None):
                raise TypeError(f"{self.name}: {name} = {value!r} must be a number or None")
        known = {k: v for k, v in values.items() if v is not None and math.isfinite(v)}
        return known or None

    def error(self, observation: Mapping[str, Any] | None) -> np.ndarray | None:
        """Measured `learnt_errors` [tolerances], NaN where unknown, shape (m,); None for none."""
        errors = self.learnt_errors()
        measured = self.measure(observation) if errors and observation is not None else None
        return None if measured is None else told(errors, measured)

    def error_model(
        self, parametrization: Parametrization, simulate: Simulate
    ) -> ErrorModel | None:
        """Model of the errors, for learners that plan on it; None if the task has none."""
        model = self.rough_errors(parametrization)
        if model is not None and type(self).predict is not Task.predict:
            model.predict = predictor(model.errors, parametrization, simulate, self.predict)
        return model

    def rough_errors(self, parametrization: Parametrization) -> RoughErrors | None:
        """The errors by their `effects` alone; None if these parameters are not learnt."""
        errors = self.learnt_errors()
        if not errors or any(each.group not in parametrization.groups for each in self.effects):
            return None
        return RoughErrors(errors, self.effects, parametrization)

    def predict(self, simulated: SimulatedRollout) -> Sequence[Mapping[str, float]]:
        """Errors of a simulated execution; a task that has none is planned by its effects alone.

        Returns:
            Values as from `measure`: as expected, and then with each number that is only assumed,
            such as a friction, off by one standard deviation.
        """
        return ()

    def outcome(self, record: LoggedRollout) -> str:
        """Outcome of a logged rollout in a few words, for one cell of a table.

        By default the errors; where none is known, a remark or whether it was a success.
        """
        if record.fault:
            return f"fault: {record.fault}"
        seen = record.observation if self.errors else None
        if not (measured := self.measure(seen) if seen is not None else None):
            return record.why or ("success" if record.success else "no success")
        return ", ".join(error.shown(measured.get(error.name)) for error in self.errors)

    def summary(self, records: Sequence[LoggedRollout]) -> list[str]:
        """Lines that summarise a session, printed at its end and in its report."""
        return []

    def achieved(self, record: LoggedRollout) -> bool:
        """Whether a rollout achieved the goal, regardless of the settings of success."""
        return record.success

    def measured(self, retests: Sequence[LoggedRollout]) -> Mapping[str, str]:
        """Values measured in the re-tests, by label, for the report and the terminal.

        By default the medians of the errors that have a limit.
        """
        seen = [self.measure(r.observation) or {} for r in retests if r.observation]
        found = {}
        for error in self.wanted_errors():
            off = [abs(each.get(error.name, math.nan) - error.target) for each in seen]
            known = [value for value in off if math.isfinite(value)]
            if error.limit < math.inf and known:
                value = error.shown(float(np.median(known)))[len(error.name) + 1 :]
                found[f"median error of the re-tests: {error.name.replace('_', ' ')}"] = value
        return found

    def figure(self, rollout: Rollout) -> tuple[Figure, str] | None:
        """Figure of a rollout, and a sentence on it, which may be empty; None for no figure.

        By default tool and body from the side of the movement.
        """
        from wam_power_ros.tasks.side_view import side_view  # imports matplotlib: slow

        return side_view(
            turned(rollout, self.heading), self.body
        ), f"Dots are camera frames of the {self.body}."


def fault_assessment(fault: Fault) -> Assessment:
    """Assessment of a rollout that was ended by a fault.

    The return is 0 if the policy exceeded a motion limit; any other fault says nothing about it.
    """
    if fault.kind.of_policy:
        return Assessment(0.0, why=f"{fault.text}: counts as return 0")
    return Assessment(None, why=fault.text)


def cut_short(policy: Policy, rollout: Rollout, settle_time: float) -> str:
    """Return why the tool path of a rollout is incomplete; empty if it is complete.

    The duration of a rollout is that of its policy plus `settle_time` [s].
    """
    duration = policy.basis.duration + settle_time
    t = rollout.tool.t
    if len(t) and t[-1] >= duration - MISSING_MAX:
        return ""
    how = f"stopped in the region {rollout.stopped_in!r}" if rollout.stopped_in else "cut short"
    return f"{how} at {t[-1] if len(t) else 0.0:.2f} s of {duration:.2f} s"
