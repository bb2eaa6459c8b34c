# SPDX-License-Identifier: Apache-2.0
"""The lines of a session's log: rollouts, and what a person had to say meanwhile.

A `Record` is one executed rollout. A `Rating` and a `Given` may come at any moment, also while the
next trial, drawn already, is under way. Each says after which rollout it takes effect, so that a
log replayed line by line draws the same policies as the session did.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from wam_power_ros.learning.policy import Policy, from_json

Kind = Literal["reproduction", "explore", "mean", "retest"]
SCHEMA = "wam_power_ros/rollout/1"


class _Line(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    def to_json(self) -> str:
        """One line of JSON; floats come back bit for bit."""
        return json.dumps(self.model_dump(mode="json", by_alias=True), allow_nan=False)


class Record(_Line):
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
        adjustment: sum of a person's ratings of it, see `with_ratings`; in the log itself ratings
            are lines of their own and this is None.
        truth: what really happened, from the stand-in; None on hardware. Never learnt from.
        clock: wall-clock figures; all that differs between two runs of one seed is in here.
    """

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
    adjustment: float | None = Field(default=None, allow_inf_nan=False)
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

    @property
    def worth(self) -> float | None:
        """The return that is learnt from: ratings included, not below 0; None without a return."""
        return None if self.ret is None else max(self.ret + (self.adjustment or 0.0), 0.0)

    @property
    def succeeded(self) -> bool:
        """Whether it met the success rule and no person thought otherwise."""
        return self.success and (self.adjustment or 0.0) >= 0.0

    @classmethod
    def from_json(cls, text: str) -> Record:
        """Record of a line.

        Raises:
            ValueError: not JSON, or not a record; the message names the field.
        """
        return cls.model_validate(json.loads(text))


class Rating(_Line):
    """A person's reward or punishment for a rollout.

    Attributes:
        schema_: version of this layout ("schema" in JSON).
        after: takes effect when so many rollouts are on record.
        rollout: number of the rollout that is rated.
        amount: is added to its return.
        note: what it did, in words.
        clock: wall-clock figures.
    """

    schema_: Literal["wam_power_ros/rating/1"] = Field(
        default="wam_power_ros/rating/1", alias="schema"
    )
    after: int = Field(ge=1)
    rollout: int = Field(ge=1)
    amount: float = Field(allow_inf_nan=False)
    note: str
    clock: dict[str, Any]


class Given(_Line):
    """A demonstration given in the middle of learning.

    Attributes:
        schema_: version of this layout ("schema" in JSON).
        after: it is reproduced next when so many rollouts are on record.
        id: of the policy.
        policy: fitted to the demonstration, as `policy.to_json` writes it.
        bag: the demonstration, as it was named.
        note: what it did, in words.
        clock: wall-clock figures.
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
    def _is_a_policy(self) -> Given:
        if self.candidate().id != self.id:
            raise ValueError(f"holds policy {self.candidate().id!r}, expected {self.id!r}")
        return self

    def candidate(self) -> Policy:
        """The policy."""
        return from_json(json.dumps(self.policy))


Event = Rating | Given
Line = Record | Rating | Given
_KINDS: dict[Any, type[Record] | type[Rating] | type[Given]] = {
    kind.model_fields["schema_"].default: kind for kind in (Record, Rating, Given)
}


def line_of(text: str) -> Line:
    """Line of a log.

    Raises:
        ValueError: not JSON, or none of the three; the message names the field.
    """
    data = json.loads(text)
    schema = data.get("schema") if isinstance(data, dict) else None
    return _KINDS.get(schema if isinstance(schema, str) else None, Record).model_validate(data)


def with_ratings(log: Sequence[Line]) -> tuple[Record, ...]:
    """The rollouts of a log, oldest first, each with the sum of its ratings as `adjustment`."""
    records = [line for line in log if isinstance(line, Record)]
    for line in log:
        if isinstance(line, Rating):
            rated = records[line.rollout - 1]
            total = (rated.adjustment or 0.0) + line.amount
            records[line.rollout - 1] = rated.model_copy(update={"adjustment": total})
    return tuple(records)


def plain(value: Any) -> Any:  # noqa: ANN401 - JSON is any of its types
    """The same as data for JSON; what is not finite becomes None."""
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
