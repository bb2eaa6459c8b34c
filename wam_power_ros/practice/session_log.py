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
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from wam_power_ros import plain_json
from wam_power_ros.learning.policy import Policy, from_json
from wam_power_ros.practice.settings import in_one_line

Kind = Literal["reproduction", "explore", "mean", "retest"]
KIND_NAMES: Mapping[str, str] = {  # for a person
    "reproduction": "reproduction",
    "explore": "exploration",
    "mean": "mean policy",
    "retest": "re-test",
}


@dataclass(frozen=True)
class Trial:
    """A rollout to be executed.

    Attributes:
        number: Position in the session, from 1.
        id: Name of the rollout and of its policy, "trial-0007".
        kind: "reproduction" of a demonstration, "explore", "mean" or "retest" (not learnt from).
        demonstration: Id of the candidate that the coordinates refer to.
        attempt: 1, or more after rollouts of the same z without a return.
        rejections: Number of infeasible samples before this one, plus the number of halvings after
            20 of them; for a mean or an answer the number of halvings, see `improvement.sample`.
        z: Coordinates. Shape (size,).
        theta: Learnt parameters in physical units. Shape (size,).
        policy: Policy to execute, at the coordinates z.
        purpose: Human-readable purpose of the trial.
    """

    number: int
    id: str
    kind: Kind
    demonstration: str
    attempt: int
    rejections: int
    z: np.ndarray
    theta: np.ndarray
    policy: Policy
    purpose: str

    def logged(self) -> dict[str, Any]:
        """Fields that its record holds."""
        fields = {name: value for name, value in vars(self).items() if name in Record.model_fields}
        return fields | {"z": self.z.tolist(), "theta": self.theta.tolist()}

    def check(self, record: Record, generator: dict[str, Any]) -> None:
        """Check that a record is of this trial.

        Args:
            record: Record as logged.
            generator: State of the session's generator after the trial was drawn.

        Raises:
            ValueError: It is of another trial; names the first difference.
        """
        for name in ("number", "id", "kind", "demonstration", "attempt"):
            wanted, got = getattr(self, name), getattr(record, name)
            if wanted != got:
                raise ValueError(
                    f"record {self.number}: {name} is {got!r}, expected {wanted!r} in this "
                    "session: other settings, seed or candidates?"
                )
        same_z = len(record.z) == len(self.z) and np.allclose(record.z, self.z, rtol=0, atol=1e-6)
        if not same_z or record.generator != generator:
            raise ValueError(
                f"record {record.number}: {'the generator' if same_z else 'z'} is not this "
                "session's: other settings, seed or candidates?"
            )


class _Line(BaseModel):
    """A line of the log; `schema_` is the version of its layout ("schema" in JSON)."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    def to_json(self) -> str:
        """One line of JSON, which restores floats bit for bit."""
        return json.dumps(self.model_dump(mode="json", by_alias=True), allow_nan=False)


class Record(_Line):
    """One executed rollout, a line of the session's log.

    Attributes:
        number, id, kind, demonstration, attempt, rejections: See `Trial`.
        z, theta: Executed parameters, as scaled coordinates and in physical units.
        learnt: Whether the rollout is learnt from.
        learnt_as: Coordinates at which it is learnt from, including the hindsight correction; None
            when not learnt from.
        ret, terms: Return and its terms; `ret` is None when the rollout is no evidence about its
            policy.
        success: Whether it met the task's criterion of success.
        why: Reason why it was not learnt from, or a remark.
        note: Human-readable decision of the practice after this rollout.
        observation: Observation of the task, as data for JSON; None when there is none.
        fault: Text of the fault or of the person's stop that ended it, empty when neither did.
        refused: Whether a person ended it: its policy has the return 0 and is not run again.
        generator: State of the random generator after this trial was drawn.
        bag: Name of its bag.
        adjustment: Sum of a person's ratings, see `with_ratings`; None in the log itself, where
            ratings are separate lines.
        truth: Ground truth of the simulator; None on hardware. Never learnt from.
        clock: Wall-clock figures; only these differ between two runs of one seed.
    """

    schema_: Literal["wam_power_ros/rollout/2"] = Field(
        default="wam_power_ros/rollout/2", alias="schema"
    )
    number: int = Field(ge=1)
    id: str
    kind: Kind
    demonstration: str
    attempt: int = Field(ge=1)
    rejections: int = Field(default=0, ge=0)
    z: list[float]
    theta: list[float]
    learnt: bool
    learnt_as: list[float] | None
    ret: float | None = Field(ge=0.0, allow_inf_nan=False)
    terms: dict[str, float | None]
    success: bool
    why: str
    note: str
    observation: dict[str, Any] | None
    fault: str
    refused: bool = False  # absent in older logs
    generator: dict[str, Any]
    bag: str
    adjustment: float | None = Field(default=None, allow_inf_nan=False)
    truth: dict[str, Any] | None
    clock: dict[str, Any]

    @model_validator(mode="after")
    def _is_consistent(self) -> Record:
        if self.learnt != (self.learnt_as is not None) or (self.learnt and self.ret is None):
            raise ValueError("a learnt rollout must have learnt_as and ret, any other no learnt_as")
        if len(self.theta) != len(self.z) or len(self.learnt_as or self.z) != len(self.z):
            raise ValueError("z, theta and learnt_as must have the same length")
        if not np.isfinite([*self.z, *self.theta, *(self.learnt_as or [])]).all():
            raise ValueError("z, theta and learnt_as must be finite")
        return self

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


class Rating(_Line):
    """A person's reward or punishment for a rollout.

    Attributes:
        after: Number of recorded rollouts when it takes effect.
        rollout: Number of the rated rollout.
        amount: Amount added to the return.
    """

    schema_: Literal["wam_power_ros/rating/1"] = Field(
        default="wam_power_ros/rating/1", alias="schema"
    )
    after: int = Field(ge=1)
    rollout: int = Field(ge=1)
    amount: float = Field(allow_inf_nan=False)
    note: str
    clock: dict[str, Any]


class NewDemonstration(_Line):
    """A demonstration added while learning.

    Attributes:
        after: Number of recorded rollouts when it takes effect.
        policy: Policy fitted to the demonstration, as `policy.to_json` writes it.
        bag: Bag of the demonstration, as given.
    """

    schema_: Literal["wam_power_ros/demonstration/1"] = Field(
        default="wam_power_ros/demonstration/1", alias="schema"
    )
    after: int = Field(ge=0)
    id: str
    policy: dict[str, Any]
    bag: str
    note: str
    clock: dict[str, Any]

    @model_validator(mode="after")
    def _is_a_policy(self) -> NewDemonstration:
        if self.candidate().id != self.id:
            raise ValueError(f"holds policy {self.candidate().id!r}, expected {self.id!r}")
        return self

    def candidate(self) -> Policy:
        """The policy fitted to the demonstration."""
        return from_json(json.dumps(self.policy))


class Pause(_Line):
    """A pause of the session, or the end of one; takes effect at once.

    Attributes:
        paused: Whether nothing moves from now on.
    """

    schema_: Literal["wam_power_ros/pause/1"] = Field(
        default="wam_power_ros/pause/1", alias="schema"
    )
    after: int = Field(ge=0)
    paused: bool
    note: str
    clock: dict[str, Any]


Event = Rating | NewDemonstration | Pause
Line = Record | Event
_KINDS: dict[Any, type[Record] | type[Rating] | type[NewDemonstration] | type[Pause]] = {
    kind.model_fields["schema_"].default: kind for kind in (Record, Rating, NewDemonstration, Pause)
}


def parse_line(text: str) -> Line:
    """Parse a line of a log.

    Raises:
        ValueError: The text is not JSON or none of the four kinds; names the fields.
    """
    data = plain_json.parse(text, "the line")
    schema = data.get("schema") if isinstance(data, dict) else None
    try:
        return _KINDS.get(schema if isinstance(schema, str) else None, Record).model_validate(data)
    except ValidationError as error:
        raise ValueError(in_one_line(error)) from None


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


def plain(value: Any) -> Any:  # noqa: ANN401 - JSON is any of its types
    """Convert a value to data for JSON; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
