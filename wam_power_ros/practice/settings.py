# SPDX-License-Identifier: Apache-2.0
"""Settings of a session: course, task and learner."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, SerializeAsAny, ValidationError, model_validator

from wam_power_ros import installed
from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.learner import ErrorModel, Learner, Model, check_errors
from wam_power_ros.learning.model_based import ModelBased
from wam_power_ros.learning.policy import PERIOD
from wam_power_ros.tasks.task import Task

SHOWN_MAX = 80  # characters of an invalid value in an error message


class PracticeSettings(BaseModel):
    """Settings of the course of a session, for any task.

    Attributes:
        budget: Number of usable rollouts, including reproductions and excluding re-tests.
        minutes: Time of all rollouts, with what is done and waited for between them, after which
            learning ends [min]; 0: no limit. With a limit, the course depends on the clock.
        mean_every: Every n-th trial of the practice runs the mean; 0 runs it only to confirm a
            success.
        confirm: Number of successes of one mean in a row that stop the session; 0 disables the
            rule. They show a success rate, see `stopping_rule.rate_shown`; fewer stop it if their
            margins show the same.
        retests: Number of runs of the final answer, which are not learnt from.
        attempts: Number of times a policy is executed while its rollouts have no return.
        return_noise: Standard deviation of the return of one policy, for `Practice.best`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    budget: int = Field(ge=1, le=100_000)  # a year of practice
    minutes: int = Field(default=0, ge=0, le=1_000_000)
    mean_every: int = Field(ge=0, le=100_000)
    confirm: int = Field(ge=0, le=1000)
    retests: int = Field(ge=0, le=100_000)
    attempts: int = Field(default=3, ge=1, le=100)
    return_noise: float = Field(default=0.1, ge=0.0, le=10.0, allow_inf_nan=False)

    def check_budget(self, reproductions: int) -> None:
        """Raise a ValueError if reproductions of demonstrations use up the budget."""
        if self.budget <= reproductions:
            raise ValueError(
                f"a budget of {self.budget} rollouts leaves none to practise after {reproductions} "
                f"reproductions of demonstrations: allow {reproductions + 1} trials or more"
            )


class SessionSettings(BaseModel):
    """All settings of a session, as `session.yaml` holds them.

    Attributes:
        task_settings: Settings of the task, of its class `Settings`.
        learner_settings: Settings of the learner, of its class `Settings`.
        practice: Settings of the course of the session.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    task: str
    task_settings: SerializeAsAny[BaseModel]
    learner: str
    learner_settings: SerializeAsAny[BaseModel]
    practice: PracticeSettings

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, values: Any) -> Any:  # noqa: ANN401 - unchecked input
        """Validate the settings of task and learner by the classes of these names."""
        if not isinstance(values, Mapping) or not {"task", "learner"} <= values.keys():
            return values
        found = dict(values)
        for key, models in (
            ("task", installed.task_type(str(values["task"])).Settings),
            ("learner", installed.find("learner", str(values["learner"])).Settings),
        ):
            own = found.get(f"{key}_settings", {})
            try:
                found[f"{key}_settings"] = models.model_validate(
                    own.model_dump() if isinstance(own, BaseModel) else own
                )
            except ValidationError as error:
                raise ValueError(in_one_line(error, f"{key}_settings.")) from None
        return found

    def make_task(self, context: Mapping[str, Any]) -> Task:
        """Create the task; `context` as returned by its `context_of`."""
        return installed.task_type(self.task)(self.task_settings, context)

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
            parametrization = task.parametrization(kind.policy_of([made_up], "made-up"))
            model = task.model(parametrization, made_up.position[0])
            errors = task.error_model(parametrization, lambda policy: None)
        except Exception:  # of any task, at what is none of its movements: demonstrations will tell
            return
        rng = np.random.Generator(np.random.PCG64(0))
        self.make_learner(parametrization.size, rng, model, errors, bool(task.corrections))

    def make_learner(
        self,
        size: int,
        rng: np.random.Generator,
        task_model: Model | None,
        error_model: ErrorModel | None = None,
        corrects: bool = False,
    ) -> Learner:
        """Create a learner.

        Args:
            size: Number of parameters.
            rng: Random generator of the exploration.
            task_model: Model of the task for a learner that needs one.
            error_model: Model of the vector error of the task for a learner that needs one.
            corrects: Whether the task corrects rollouts, for a learner of corrections alone.

        Raises:
            ValueError: The learner needs a model and the task has none; names those that work.
        """
        models = {
            "needs_model": ("the returns", task_model),
            "needs_error_model": ("the vector error", error_model),
        }

        def given(name: str) -> list[Model | ErrorModel | None]:
            kind = installed.find("learner", name)
            needed = [need for need in models if getattr(kind, need, False)]
            for what, model in map(models.__getitem__, needed):
                if model is None:
                    text = f"learner {name!r} needs a model of {what}, which task {self.task!r}"
                    raise ValueError(f"{text} with these settings does not have")
            check_errors(kind, self.task, corrects)
            return [models[need][1] for need in needed]

        def works(name: str) -> bool:
            try:
                given(name)
            except ValueError:  # one of another package that cannot be loaded is none, too
                return False
            return True

        kind = installed.find("learner", self.learner)
        try:
            chosen = given(self.learner)
        except ValueError as error:
            working = ", ".join(filter(works, installed.names("learner")))
            raise ValueError(f"{error}; learners that work: {working}") from None
        learner: Learner = kind(size, self.learner_settings, rng, *chosen)
        return learner


def preset(
    task: str,
    name: str = "",
    learner: Mapping[str, Any] | None = None,
    **changes: Any,  # noqa: ANN401 - checked by the models
) -> SessionSettings:
    """Settings of a preset of a task, with changes.

    Args:
        task: Name of the task.
        name: Name of the preset; the task's first when empty.
        learner: Changes of the learner's settings. If its key `name` is another learner than
            the preset's, changes of that learner's defaults.
        **changes: Fields of `PracticeSettings` or of the task's settings; a mapping for a field
            that is a mapping changes only the keys it contains.

    Raises:
        ValueError: The task, preset, learner or a field is unknown, or a value is out of range.
    """
    kind = installed.task_type(task)
    name = name or next(iter(kind.presets))
    if name not in kind.presets:
        raise ValueError(f"preset {name!r} of {task!r} is not one of {', '.join(kind.presets)}")
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
    learner_name = learning.pop("name")
    try:
        return SessionSettings.model_validate(
            {
                "task": task,
                "task_settings": values,
                "learner": learner_name,
                "learner_settings": learning,
                "practice": course,
            }
        )
    except ValidationError as error:
        raise ValueError(f"invalid settings of task {task!r}: {in_one_line(error)}") from None


def _made_up_movement() -> Demonstration:
    """A movement of 1 s along a bow of 0.4 m."""
    t = PERIOD * np.arange(round(1.0 / PERIOD))
    s = t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
    position = np.stack([0.6 + 0.1 * s, 0.4 * s - 0.2, 0.5 + 0.4 * s * (1.0 - s)], axis=1)
    velocity = np.gradient(position, t, axis=0)
    acceleration = np.gradient(velocity, t, axis=0)
    q, upright = np.outer(s, np.full(7, 0.3)), np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    return Demonstration(t, q, position, velocity, acceleration, upright, PERIOD)


def in_one_line(error: ValidationError, prefix: str = "") -> str:
    """Key, value and rule of every fault of a validation error, in one line.

    Args:
        error: Error of a model.
        prefix: Prefix of every key.
    """
    lines = []
    for fault in error.errors():
        rule = fault["msg"].removeprefix("Value error, ")
        key = ".".join(map(str, fault["loc"]))
        shown = repr(fault["input"])
        shown = shown if len(shown) <= SHOWN_MAX else f"{shown[:SHOWN_MAX]}..."
        value = "" if isinstance(fault["input"], Mapping) else f" = {shown}"
        lines.append(f"{prefix}{key}{value}: {rule}" if key else rule)
    return "; ".join(lines)
