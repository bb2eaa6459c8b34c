# SPDX-License-Identifier: Apache-2.0
"""Improvement of one demonstration by a learner, feasible sampling and a stopping rule."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from wam_power_ros.faults import Fault
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.feasible_sampler import sample, shrink
from wam_power_ros.practice.session_log import Kind, Record
from wam_power_ros.practice.settings import SessionSettings
from wam_power_ros.practice.stopping_rule import StoppingRule
from wam_power_ros.tasks.task import Task


class ArmModel(Protocol):
    """Model of the arm as a practice needs it."""

    def infeasible(self, policy: Policy, overruns: int = 0) -> Fault | None:
        """Fault in which a simulated execution of a policy ends, None if it is feasible.

        Must be a function of its arguments: a replay depends on it.

        Args:
            policy: Policy to simulate.
            overruns: Number of rollouts in which the arm exceeded a limit that its model kept.
        """

    def tool_position(self, q: np.ndarray) -> np.ndarray:
        """Position of the tool at joint angles q [m]. Shape (3,)."""


def feasibility(
    parametrization: Parametrization, arm: ArmModel, records: Sequence[Record], name: str
) -> Callable[[np.ndarray], bool]:
    """Function that returns whether the policy at coordinates (size,) is feasible.

    Args:
        parametrization: Parametrization of the demonstration.
        arm: Model of the arm.
        records: Rollouts of the session so far.
        name: Id of the simulated policies.
    """
    # A fault with return 0 is a motion limit that the model had kept; others leave no return.
    overruns = sum(bool(record.fault) and record.ret is not None for record in records)

    def is_feasible(z: np.ndarray) -> bool:
        policy, _ = parametrization.policy(z, name)
        return arm.infeasible(policy, overruns) is None

    return is_feasible


class Improvement:
    """Selects trials around one demonstration and learns from their records.

    Attributes:
        demonstration: Id of the candidate that is learnt from.
        parametrization: Its parametrization.
        learner: Learner; read-only for callers.
        practised: Number of finished trials of the practice, including dropped ones.

    Args:
        parametrization: Parametrization of the demonstration.
        settings: Settings of the session.
        task: Task that is practised.
        rng: Random generator of the exploration.
        arm: Model of the arm.
        records: Rollouts of the session so far; those of this demonstration are learnt from.
        practised: Number of finished trials of the practice.
    """

    def __init__(
        self,
        parametrization: Parametrization,
        settings: SessionSettings,
        task: Task,
        rng: np.random.Generator,
        arm: ArmModel,
        records: Sequence[Record],
        practised: int,
    ) -> None:
        self.demonstration = parametrization.policy0.id
        self.parametrization = parametrization
        self.practised = practised
        self._settings, self._task, self._arm, self._rng = settings, task, arm, rng
        self._rule = StoppingRule(settings.practice, task.confirms)
        self.learn_again(records)

    @property
    def answer(self) -> np.ndarray:
        """Answer if the session stopped now: the mean under test or the latest. Shape (size,)."""
        return self.learner.mean if self._rule.z is None else self._rule.z

    @property
    def confirmed(self) -> bool:
        """Whether a mean fulfils the stopping rule."""
        return self._rule.complete

    def learn_again(self, records: Sequence[Record]) -> None:
        """Start a new learner and feed it all rollouts of the demonstration, in their order."""
        start = self._arm.tool_position(self.parametrization.policy0.q_start)
        model = self._task.model(self.parametrization, start)
        self.learner = self._settings.make_learner(self.parametrization.size, self._rng, model)
        for record in records:
            if record.demonstration == self.demonstration and record.learnt_as is not None:
                self.learner.tell(np.array(record.learnt_as), float(record.rated_return or 0.0))

    def forget_success(self, record: Record) -> None:
        """Restart the stopping rule if this record was one of its successes."""
        self._rule.forget(record)

    def draw(
        self, records: Sequence[Record], rejections: int | None
    ) -> tuple[Kind, np.ndarray, int, str]:
        """Next trial: the mean being confirmed, the current mean, or an exploration.

        Args:
            records: Rollouts of the session so far.
            rejections: Logged number of rejections in a replay, else None; see
                `feasible_sampler.sample`.

        Returns:
            Kind, coordinates (size,), number of rejections and purpose.
        """
        rule, settings = self._rule, self._settings.practice
        if rule.z is not None:
            return "mean", rule.z, 0, f"confirms a mean, {rule.count + 1} of {settings.confirm}"
        every = settings.mean_every
        if rule.mean_is_due or (every > 0 and (self.practised + 1) % every == 0):
            mean = self.shrunk(self.learner.mean, records, rejections)
            return "mean", *mean, "the mean, without exploration"
        drawn = sample(self.learner, *self._feasible(records), rejections)
        return "explore", *drawn, "explores"

    def shrunk(
        self, z: np.ndarray, records: Sequence[Record], rejections: int | None
    ) -> tuple[np.ndarray, int]:
        """Coordinates shrunk until they are feasible, and the number of halvings; see `draw`."""
        return shrink(z, *self._feasible(records), rejections)

    def add(self, record: Record) -> str:
        """Learn from a record of an exploration or a mean; returns a remark for the log."""
        self.practised += 1
        if record.learnt_as is not None and record.ret is not None:
            self.learner.tell(np.array(record.learnt_as), record.ret)
        return self._rule.add(record) or ("" if record.ret is not None else "dropped")

    def _feasible(
        self, records: Sequence[Record]
    ) -> tuple[np.ndarray, Callable[[np.ndarray], bool]]:
        """Coordinates of the fault-free rollout with the highest return, else 0; `feasibility`."""
        ran = [
            record
            for record in records
            if record.demonstration == self.demonstration
            and record.rated_return is not None
            and not record.fault
        ]
        z = np.zeros(self.parametrization.size)
        if ran:
            z = np.array(max(ran, key=lambda record: record.rated_return or 0.0).z)
        return z, feasibility(self.parametrization, self._arm, records, "sample")
