# SPDX-License-Identifier: Apache-2.0
"""The lines of a session's log: what was executed, what came of it, what was made of it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

Kind = Literal["reproduction", "explore", "mean", "retest"]
SCHEMA = "wam_power_ros/rollout/1"


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
