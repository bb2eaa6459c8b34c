# SPDX-License-Identifier: Apache-2.0
"""Trials, and the lines of a session's log: rollouts and what a person does.

A `Trial` is a rollout to be executed, a `Record` the same rollout once it was executed. A `Rating`,
a `NewDemonstration` and a `Pause` may come at any moment, even while a trial is being executed.
Each holds the rollout after which it takes effect, so that replaying the log line by line selects
the same policies as the session did.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from wam_power_ros import plain_json
from wam_power_ros.faults import FaultKind
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy, from_json
from wam_power_ros.practice.settings import validated

Kind = Literal["reproduction", "explore", "mean", "retest"]
KIND_NAMES: Mapping[str, str] = {  # for a person
    "reproduction": "reproduction",
    "explore": "exploration",
    "mean": "mean policy",
    "retest": "re-test",
}


@dataclass(frozen=True)
class Trial:
    """A rollout to be executed."""

    number: int  # position in the session, from 1
    id: str  # name of the rollout and of its policy, "trial-0007"
    kind: Kind  # a re-test is not learnt from
    demonstration: str  # id of the candidate that the coordinates refer to
    attempt: int  # 1, or more after rollouts of the same z without a return
    # Infeasible samples before this one, plus halvings after 20 of them; for a mean or an answer
    # the number of halvings, see `learning_run.sample`
    rejections: int
    z: np.ndarray  # coordinates, shape (size,)
    theta: np.ndarray  # learnt parameters in physical units, shape (size,)
    policy: Policy  # to be executed, at the coordinates z
    purpose: str  # human-readable

    @classmethod
    def at(
        cls,
        number: int,
        parametrization: Parametrization,
        kind: Kind,
        z: np.ndarray,
        purpose: str,
        rejections: int = 0,
        attempt: int = 1,
    ) -> Trial:
        """Trial of the policy at coordinates z (size,) of a demonstration."""
        policy, z = parametrization.policy(z, f"trial-{number:04d}")
        theta, name = parametrization.theta(z), parametrization.policy0.id
        z.setflags(write=False)
        theta.setflags(write=False)
        return cls(number, policy.id, kind, name, attempt, rejections, z, theta, policy, purpose)

    def logged(self) -> dict[str, Any]:
        """Fields that its record holds."""
        fields = {name: value for name, value in vars(self).items() if name in Record.model_fields}
        return fields | {"z": self.z.tolist(), "theta": self.theta.tolist()}

    def check(self, record: Record, generator: dict[str, Any]) -> None:
        """Check that a record is of this trial, and the generator's state of after it was drawn.

        Raises:
            ValueError: It is of another trial; names the first difference.
        """
        differ = [
            f"{name} is {getattr(record, name)!r}, expected {getattr(self, name)!r} in this session"
            for name in ("number", "id", "kind", "demonstration", "attempt")
            if getattr(record, name) != getattr(self, name)
        ]
        if len(record.z) != len(self.z) or not np.allclose(record.z, self.z, rtol=0, atol=1e-6):
            differ.append("z is not this session's")
        if record.generator != generator:
            differ.append("the generator is not this session's")
        if differ:
            raise ValueError(
                f"record {self.number}: {differ[0]}: other settings, seed or candidates?"
            )


def plain(value: Any) -> Any:  # noqa: ANN401 - JSON is any of its types
    """Convert a value to data for JSON; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


Terms = Annotated[Mapping[str, float | None], BeforeValidator(plain)]
Data = Annotated[Mapping[str, Any], BeforeValidator(plain)]


class _Line(BaseModel):
    """A line of the log, with the version of its layout ("schema" in JSON)."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    def to_json(self) -> str:
        """One line of JSON, which restores floats bit for bit."""
        return json.dumps(self.model_dump(mode="json", by_alias=True), allow_nan=False)


class Record(_Line):
    """One executed rollout, a line of the session's log; for what has no comment see `Trial`."""

    schema_: Literal["wam_power_ros/rollout/3"] = Field(
        default="wam_power_ros/rollout/3", alias="schema"
    )
    number: int = Field(ge=1)
    id: str
    kind: Kind
    demonstration: str
    attempt: int = Field(ge=1)
    rejections: int = Field(default=0, ge=0)
    z: list[float]  # as executed
    theta: list[float]
    learnt: bool  # whether it is learnt from
    # Coordinates at which it is learnt from, including the correction of errors; None: it is not
    z_corrected: list[float] | None
    # Return; None when the rollout is no evidence about its policy
    ret: float | None = Field(ge=0.0, allow_inf_nan=False)
    terms: Terms  # of the return
    success: bool  # whether it met the task's criterion of success
    why: str  # reason why it was not learnt from, or a remark
    note: str  # human-readable decision of the practice after this rollout
    observation: Data | None  # of the task; None when there is none
    fault: str  # or the person's stop that ended it, empty when neither did
    fault_kind: FaultKind | None = None  # of the controller; absent in older logs
    # Whether a person ended it: its policy has the return 0 and is not run again
    refused: bool = False  # absent in older logs
    generator: dict[str, Any]  # state of the random generator after this trial was drawn
    bag: str  # its name
    # Sum of a person's ratings, see `with_ratings`; None in the log itself, where they are lines
    adjustment: float | None = Field(default=None, allow_inf_nan=False)
    truth: Data | None  # of the simulator; None on hardware; never learnt from
    clock: Data  # wall-clock figures; only these differ between two runs of one seed

    @model_validator(mode="after")
    def _is_consistent(self) -> Record:
        if self.learnt != (self.z_corrected is not None) or (self.learnt and self.ret is None):
            raise ValueError("a learnt rollout has z_corrected and ret, any other no z_corrected")
        if len(self.theta) != len(self.z) or len(self.z_corrected or self.z) != len(self.z):
            raise ValueError("z, theta and z_corrected must have the same length")
        if not np.isfinite([*self.z, *self.theta, *(self.z_corrected or [])]).all():
            raise ValueError("z, theta and z_corrected must be finite")
        return self

    @property
    def executed(self) -> tuple[str, tuple[float, ...]]:
        """Demonstration and coordinates, which together are a policy."""
        return self.demonstration, tuple(self.z)

    @property
    def rated_return(self) -> float | None:
        """Return including ratings, at least 0; None without a return."""
        return None if self.ret is None else max(self.ret + (self.adjustment or 0.0), 0.0)

    @property
    def succeeded(self) -> bool:
        """Whether the rollout was a success and was not punished."""
        return self.success and (self.adjustment or 0.0) >= 0.0

    def with_rating(self, amount: float) -> Record:
        """The record with a further rating of this amount."""
        return self.model_copy(update={"adjustment": (self.adjustment or 0.0) + amount})


class _Event(_Line):
    """What a person does, or a pause."""

    schema_: str = Field(alias="schema")
    after: int = Field(ge=0)  # number of recorded rollouts when it takes effect; a pause does now
    note: str  # human-readable effect, or reason of a pause
    clock: Data  # wall-clock figures


class Rating(_Event):
    """A person's reward or punishment: the amount is added to the return of a rollout."""

    schema_: Literal["wam_power_ros/rating/1"] = Field(
        default="wam_power_ros/rating/1", alias="schema"
    )
    after: int = Field(ge=1)
    rollout: int = Field(ge=1)
    amount: float = Field(allow_inf_nan=False)


class NewDemonstration(_Event):
    """A demonstration added while learning."""

    schema_: Literal["wam_power_ros/demonstration/1"] = Field(
        default="wam_power_ros/demonstration/1", alias="schema"
    )
    id: str  # of the policy
    policy: dict[str, Any]  # fitted to the demonstration, as `policy.to_json` writes it
    bag: str  # of the demonstration, as given

    @model_validator(mode="after")
    def _is_a_policy(self) -> NewDemonstration:
        if self.candidate().id != self.id:
            raise ValueError(f"holds policy {self.candidate().id!r}, expected {self.id!r}")
        return self

    def candidate(self) -> Policy:
        """The policy fitted to the demonstration."""
        return from_json(json.dumps(self.policy))


class Pause(_Event):
    """A pause of the session, while which nothing moves, or the end of one."""

    schema_: Literal["wam_power_ros/pause/1"] = Field(
        default="wam_power_ros/pause/1", alias="schema"
    )
    paused: bool


Event = Rating | NewDemonstration | Pause
Line = Record | Event
_KINDS: dict[Any, type[Line]] = {
    kind.model_fields["schema_"].default: kind for kind in (Record, Rating, NewDemonstration, Pause)
}


def parse_line(text: str) -> Line:
    """Parse a line of a log.

    Raises:
        ValueError: The text is not JSON or none of the four kinds; names the fields.
    """
    data = plain_json.parse(text, "the line")
    schema = data.get("schema") if isinstance(data, dict) else None
    return validated(_KINDS.get(schema if isinstance(schema, str) else None, Record), data)


def out_of_order(line: Line, count: int) -> str:
    """Reason why a line cannot follow `count` rollouts, empty if it can."""
    if isinstance(line, Record):
        wrong = line.number != count + 1
        return f"rollout {line.number} cannot follow rollout {count}" if wrong else ""
    if isinstance(line, Rating) and line.rollout > count:
        return f"rollout {line.rollout} is rated before it is recorded"
    if line.after in (count, count + 1):
        return ""
    return f"a line that takes effect after rollout {line.after} cannot follow rollout {count}"


def with_ratings(log: Sequence[Line]) -> tuple[Record, ...]:
    """Rollouts of a log, oldest first, each with the sum of its ratings as `adjustment`."""
    records = [line for line in log if isinstance(line, Record)]
    for line in log:
        if isinstance(line, Rating):
            records[line.rollout - 1] = records[line.rollout - 1].with_rating(line.amount)
    return tuple(records)


def columns(records: Sequence[Record]) -> dict[str, list[Any]]:
    """Columns of a table of rollouts, a row for each; None where a rollout has no such value.

    Terms are "term.NAME", coordinates "z.0", ..., parameters in physical units "theta.0", ...
    """
    head = ("number", "kind", "demonstration", "ret", "rated_return", "success", "fault", "why")
    rows = []
    for record in records:
        row = {name: getattr(record, name) for name in head}
        row |= {f"term.{name}": value for name, value in record.terms.items()}
        row |= {f"z.{i}": value for i, value in enumerate(record.z)}
        row |= {f"theta.{i}": value for i, value in enumerate(record.theta)}
        rows.append(row | {"bag": record.bag})
    names = dict.fromkeys([*head, *(name for row in rows for name in row)])
    return {name: [row.get(name) for row in rows] for name in names}
