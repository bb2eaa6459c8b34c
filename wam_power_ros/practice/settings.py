# SPDX-License-Identifier: Apache-2.0
"""Settings of a session: course, task and learner."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, SerializeAsAny, ValidationError, model_validator

from wam_power_ros import installed, plain_json
from wam_power_ros.learning.demonstration import Demonstration, from_positions
from wam_power_ros.learning.learner import ErrorModel, Learner, needs_errors
from wam_power_ros.learning.model_based import ModelBased
from wam_power_ros.learning.policy import PERIOD
from wam_power_ros.tasks.task import Task

M = TypeVar("M", bound=BaseModel)
SHOWN_MAX = 80  # characters of an invalid value in an error message


class PracticeSettings(BaseModel):
    """Settings of the course of a session, for any task."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Number of usable rollouts, including reproductions and excluding re-tests
    budget: int = Field(default=60, ge=1, le=100_000)  # a year of practice
    # Time of all rollouts, with what is done and waited for between them, after which learning ends
    # [min]; 0: no limit. With a limit, the course depends on the clock.
    minutes: int = Field(default=0, ge=0, le=1_000_000)
    # Number of spring-dampers of a policy that is fitted; 0: as many as the task asks for
    springs: int = Field(default=0, ge=0, le=64)
    # Every n-th trial of the practice runs the mean; 0 runs it only to confirm a success
    mean_every: int = Field(default=5, ge=0, le=100_000)
    # Number of successes of a mean that never failed which stop the session; 0 disables the rule.
    # They show a success rate, see `stopping_rule.rate_shown`; fewer do if their margins show it.
    confirm: int = Field(default=29, ge=0, le=1000)
    # Runs of the final answer, which are not learnt from
    retests: int = Field(default=10, ge=0, le=100_000)
    # Number of times a policy is executed while its rollouts have no return
    attempts: int = Field(default=3, ge=1, le=100)
    # Standard deviation of the return of one policy, for `Practice.best`
    return_noise: float = Field(default=0.1, ge=0.0, le=10.0, allow_inf_nan=False)

    def check_budget(self, reproductions: int) -> None:
        """Raise a ValueError if reproductions of demonstrations use up the budget."""
        if self.budget <= reproductions:
            raise ValueError(
                f"a budget of {self.budget} rollouts leaves none to practise after {reproductions} "
                f"reproductions of demonstrations: allow {reproductions + 1} trials or more"
            )


class SessionSettings(BaseModel):
    """All settings of a session, as `session.yaml` holds them; task and learner by their names."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    task: str
    task_settings: SerializeAsAny[BaseModel]  # of its class `Settings`
    learner: str
    learner_settings: SerializeAsAny[BaseModel]  # of its class `Settings`
    practice: PracticeSettings

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, values: Any) -> Any:  # noqa: ANN401 - unchecked input
        """Validate the settings of task and learner by the classes of these names."""
        if not isinstance(values, Mapping) or not {"task", "learner"} <= values.keys():
            return values
        found = dict(values)
        task = installed.task_type(str(values["task"]))
        learner = installed.find("learner", str(values["learner"]))
        for key, kind in (("task_settings", task), ("learner_settings", learner)):
            own = found.get(key, {})
            own = own.model_dump() if isinstance(own, BaseModel) else own
            found[key] = validated(kind.Settings, own, prefix=f"{key}.")
        return found

    def make_task(self, context: Mapping[str, Any]) -> Task:
        """Create the task; `context` as returned by its `context_of`."""
        return installed.task_type(self.task)(self.task_settings, context)

    def described(self, task: Task) -> str:
        """Task, learner and what it learns from, in a few words."""
        errors = ", ".join(error.name.replace("_", " ") for error in task.learnt_errors())
        told = (needs_errors(installed.find("learner", self.learner)) and errors) or "the return"
        if told != errors and task.corrections:
            told += f", corrected by {errors}"
        return f"task {self.task}, learner {self.learner}: learns from {told}"

    def check(self, demonstrations: int) -> None:
        """Refuse what no demonstration mends, before anybody teaches; a made-up one stands for it.

        Raises:
            ValueError: The demonstrations use up the budget, or the learner lacks a model.
        """
        kind = installed.task_type(self.task)
        self.practice.check_budget(1 if kind.single_policy else demonstrations)
        made_up = _made_up_movement()
        try:
            task = self.make_task(kind.context_of([made_up], None))
            parametrization = task.parametrization(
                kind.policy_of([made_up], "made-up", self.practice.springs)
            )
            errors = task.error_model(parametrization, lambda policy: None)
        except Exception:  # of any task, at what is none of its movements: demonstrations will tell
            return
        rng = np.random.Generator(np.random.PCG64(0))
        self.make_learner(parametrization.size, rng, errors, bool(task.corrections))

    def make_learner(
        self,
        size: int,
        rng: np.random.Generator,
        model: ErrorModel | None = None,
        corrects: bool = False,
    ) -> Learner:
        """Create a learner of z in R^size that explores by `rng`, with a model if it needs one.

        `corrects`: whether the task corrects rollouts, for a learner of corrections alone.

        Raises:
            ValueError: The learner needs errors and the task has none, or corrects by what it does
                not learn; names learners that work.
        """
        task = f"task {self.task!r} with these settings"
        if corrects and model is None:
            moved = ", ".join(effect.group for effect in installed.task_type(self.task).effects)
            raise ValueError(f"{task} corrects by its effects, but does not learn all of {moved}")

        def given(name: str) -> list[ErrorModel]:
            kind = installed.find("learner", name)
            needed = getattr(kind, "needs_error_model", False)
            if needed and model is None:
                text = f"learner {name!r} needs a model of the vector error, which"
                raise ValueError(f"{text} {task} does not have")
            if getattr(kind, "needs_corrections", False) and not corrects:
                raise ValueError(
                    f"learner {name!r} learns from errors, {task} from its return alone: it has no "
                    "errors and effects, no gain, or a return of its own without its own errors"
                )
            return [model] if needed and model is not None else []

        kind = installed.find("learner", self.learner)
        try:
            chosen = given(self.learner)
        except ValueError as error:
            working = []
            for name in installed.names("learner"):
                with suppress(ValueError):  # one of another package that cannot be loaded is none
                    given(name)
                    working.append(name)
            raise ValueError(f"{error}; learners that work: {', '.join(working)}") from None
        learner: Learner = kind(size, self.learner_settings, rng, *chosen)
        return learner


def preset(
    task: str,
    name: str = "",
    learner: Mapping[str, Any] | None = None,
    **changes: Any,  # noqa: ANN401 - checked by the models
) -> SessionSettings:
    """Settings of a preset of a task, its first without a name, with changes.

    `learner` changes the learner's settings, or the defaults of another learner if its key `name`
    is not the preset's; `changes` are fields of `PracticeSettings` or of the task's settings. A
    mapping for a field that is a mapping changes only the keys it contains.

    Raises:
        ValueError: The task, preset, learner or a field is unknown, or a value is out of range.
    """
    kind = installed.task_type(task)
    name = name or next(iter(kind.presets))
    if name not in kind.presets:
        hint = installed.did_you_mean(name, kind.presets)
        known = ", ".join(kind.presets)
        raise ValueError(f"preset {name!r} of {task!r} is not one of {known}{hint}")
    values = dict(kind.presets[name])
    errors = kind.learns_from_errors()
    learning = {"name": "model_based" if errors else "power", **values.pop("learner", {})}
    if learning["name"] == "model_based" and not errors:  # a return of its own is learnt from
        learning = {"name": "power", **ModelBased.Settings().fallback.model_dump()}
    if learner and learner.get("name", learning["name"]) != learning["name"]:
        learning = {}
    learning |= learner or {}
    for key, value in changes.items():
        if isinstance(value, Mapping) and isinstance(values.get(key), Mapping):
            value = {**values[key], **value}
        values[key] = value
    course = {key: values.pop(key) for key in PracticeSettings.model_fields if key in values}
    parts = {"task": task, "task_settings": values, "practice": course}
    parts |= {"learner": learning.pop("name"), "learner_settings": learning}
    return validated(SessionSettings, parts, f"invalid settings of task {task!r}: ")


def of_parameters(given: Mapping[str, Any]) -> SessionSettings:
    """Settings of a new session by the parameters of the learner's node, whose others are ignored.

    `task`, `preset`, `learner`, `trials` and `minutes` are values, empty or 0 for the preset's;
    `changes` is a JSON object of changes to the preset.

    Raises:
        ValueError: See `preset`; or `changes` is none.
    """
    changes = plain_json.parse(given["changes"] or "{}", "changes")
    if not isinstance(changes, dict):
        raise ValueError(f"changes {given['changes']!r} must be a JSON object")
    if given["trials"]:
        changes["budget"] = given["trials"]
    if given["minutes"]:
        changes["minutes"] = given["minutes"]
    if given["learner"]:
        changes["learner"] = {"name": given["learner"], **changes.get("learner", {})}
    return preset(given["task"], given["preset"], **changes)


def _made_up_movement() -> Demonstration:
    """A movement of 1 s along a bow of 0.4 m."""
    t = PERIOD * np.arange(round(1.0 / PERIOD))
    s = t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
    position = np.stack([0.6 + 0.1 * s, 0.4 * s - 0.2, 0.5 + 0.4 * s * (1.0 - s)], axis=1)
    return from_positions(position, PERIOD)


def validated(model: type[M], data: object, where: str = "", prefix: str = "") -> M:
    """Data as a model.

    Raises:
        ValueError: They are refused; `where`, then with a prefix key, value and rule of each fault.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        faults = error.errors()
    lines = []
    for fault in faults:
        rule = fault["msg"].removeprefix("Value error, ")
        key, shown = ".".join(map(str, fault["loc"])), repr(fault["input"])
        shown = shown if len(shown) <= SHOWN_MAX else f"{shown[:SHOWN_MAX]}..."
        value = "" if isinstance(fault["input"], Mapping) else f" = {shown}"
        lines.append(f"{prefix}{key}{value}: {rule}" if key else rule)
    raise ValueError(where + "; ".join(lines))
