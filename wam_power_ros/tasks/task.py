# SPDX-License-Identifier: Apache-2.0
"""A task: what a skill is to a session that practises it.

A class that satisfies `Task` is found by its entry point in the group `wam_power_ros.tasks`, so a
laboratory's own task lives in the laboratory's own package. Everything that is about one task only
(its return, its tracked body, its corrections) stands in its class and nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from pydantic import BaseModel

from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.learner import Model
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Fault, Rollout

CUT_SHORT = 0.05  # [s] by which a path may be shorter than its rollout and still count as complete


@dataclass(frozen=True)
class Assessment:
    """Return and success of one rollout.

    Attributes:
        ret: Return, at least 0; None when the rollout says nothing about its policy.
        terms: Terms of the return, by name.
        observation: Observation of the rollout, as data for JSON; None when there is none.
        success: Whether the rollout met the task's criterion of success.
        why: Reason for a missing return, or a remark; may be empty.
    """

    ret: float | None
    terms: Mapping[str, float] = field(default_factory=dict)
    observation: Mapping[str, Any] | None = None
    success: bool = False
    why: str = ""


class Pose(NamedTuple):
    """Pose of a frame in the base frame."""

    position: np.ndarray  # (3,) [m]
    rotation: np.ndarray  # (3, 3)


class BodyState(Protocol):
    """State of the tracked body in the base frame, as the tracker estimates it.

    Attributes:
        position: Position of the centre [m]. Shape (3,).
        velocity: Linear velocity [m/s]. Shape (3,).
    """

    @property
    def position(self) -> np.ndarray:
        """Position of the centre [m]. Shape (3,)."""

    @property
    def velocity(self) -> np.ndarray:
        """Linear velocity [m/s]. Shape (3,)."""


class Judged(Protocol):
    """The part of a logged rollout that a task's report may use; see `session_log.Record`."""

    kind: str
    ret: float | None
    observation: Mapping[str, Any] | None
    success: bool
    why: str
    fault: str
    truth: Mapping[str, Any] | None


class Task(Protocol):
    """One skill under one set of settings.

    Class attributes:
        name: Name of the task, as in `--task NAME`.
        body: Name of the rigid body that is tracked, "" for none; topics are called after it.
        together: Whether all demonstrations are fitted by one policy; otherwise each by its own,
            and the one that reproduces best is learnt from.
        Settings: Model of the task's own settings; frozen, unknown fields refused.
        presets: Name -> settings of a session: fields of `Settings`, fields of
            `practice.settings.PracticeSettings`, and `learner`, a mapping with a learner's name and
            settings. The first preset is the default.

    A task is made from its settings and from `context`, which `context_of` derived from the
    demonstrations when the session began and the session has kept.
    """

    name: ClassVar[str]
    body: ClassVar[str]
    together: ClassVar[bool]
    Settings: ClassVar[type[BaseModel]]
    presets: ClassVar[Mapping[str, Mapping[str, Any]]]

    def __init__(self, settings: Any, context: Mapping[str, Any]) -> None:  # noqa: ANN401
        """Make the task; `settings` are of its own `Settings`."""

    @classmethod
    def policy_of(cls, demonstrations: Sequence[Demonstration], policy_id: str) -> Policy:
        """Fit a policy to demonstrations.

        Raises:
            ValueError: Nothing can be fitted to them, with the reason.
        """

    @classmethod
    def context_of(
        cls, demonstrations: Sequence[Demonstration], obstacle: Sequence[float]
    ) -> dict[str, Any]:
        """What the task must remember of the beginning of a session, as data for JSON.

        Args:
            demonstrations: All of the session.
            obstacle: Sphere that ends a rollout, x, y, z and radius [m]; radius 0 for none.
        """

    @property
    def settle_time(self) -> float:
        """Time a rollout goes on after the movement [s]."""

    def parametrization(self, policy: Policy) -> Parametrization:
        """What is learnt of a policy."""

    def ready(self, body: BodyState | None, tool: Pose) -> str:
        """What is missing before a rollout may begin, for a person; empty when nothing is.

        Args:
            body: State of the tracked body, None when it was not seen or there is none.
            tool: Pose of the tool at the start of the policy.
        """

    def assess(self, policy: Policy, rollout: Rollout) -> Assessment:
        """Return and success of a rollout of `policy`."""

    def hindsight(
        self, assessment: Assessment, parametrization: Parametrization
    ) -> Sequence[np.ndarray]:
        """Shifts of the coordinates that together would have done better; none for no correction.

        What was executed is learnt from at the shifted coordinates. A measured error has a
        direction, which a return does not have.

        Returns:
            Shifts of z, shape (size,) each, one for each error; where the arm cannot follow all of
            them, each in turn as far as it can.
        """

    def confirms(self, record: Judged) -> bool:
        """Whether a successful rollout of the mean succeeded by a margin that counts."""

    def model(self, parametrization: Parametrization, start: np.ndarray) -> Model | None:
        """Prediction of returns for learners that screen candidates; None when there is none.

        Args:
            parametrization: Meaning of the coordinates.
            start: Position of the tool at the start of the policy [m]. Shape (3,).
        """

    def outcome(self, record: Judged) -> str:
        """Outcome of a logged rollout in a few words: one cell of every table."""

    def summary(self, records: Sequence[Judged]) -> list[str]:
        """Lines about the outcome of a session, for its end and for its report."""


def fault_assessment(fault: Fault) -> Assessment:
    """Assessment of a rollout that a fault ended.

    A limit of motion was exceeded by the policy itself: its return is 0. Any other fault says
    nothing about the policy.
    """
    if fault.kind.of_policy:
        return Assessment(0.0, why=f"{fault.text}: counts as return 0")
    return Assessment(None, why=fault.text)


def cut_short(policy: Policy, rollout: Rollout, settle_time: float) -> str:
    """Why a path ends before its rollout does; empty when it is complete.

    Args:
        policy: Policy that was executed.
        rollout: Its rollout.
        settle_time: Time a rollout goes on after the movement [s].
    """
    duration = policy.basis.duration + settle_time
    t = rollout.tool.t
    if len(t) and t[-1] >= duration - CUT_SHORT:
        return ""
    return f"cut short at {t[-1] if len(t) else 0.0:.2f} s of {duration:.2f} s"
