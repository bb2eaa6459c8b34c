# SPDX-License-Identifier: Apache-2.0
"""Improvement of one demonstration by a learner, with feasible sampling.

Coordinates are infeasible when the simulation of their policy on the rigid-body model ends in a
fault. Infeasible samples are rejected; after 20 rejections, the last is shrunk to feasible
coordinates. The number of rejections is logged: a replay passes it in, and nothing is simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from wam_power_ros.faults import Fault
from wam_power_ros.learning.learner import Learner, MeasuringLearner
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Foreseen
from wam_power_ros.practice.past import Past
from wam_power_ros.practice.session_log import Kind, Record
from wam_power_ros.practice.settings import SessionSettings
from wam_power_ros.practice.stopping_rule import StoppingRule
from wam_power_ros.tasks.task import Task

REJECTIONS_MAX = 20
HALVINGS_MAX = 5  # of the distance from coordinates that ran without a fault to infeasible ones


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

    def foresee(self, policy: Policy) -> Foreseen | None:
        """Simulated execution of a policy; None if it ends in a fault.

        Must be a function of its arguments: a replay depends on it.
        """


def feasibility(
    parametrization: Parametrization, arm: ArmModel, overruns: int, name: str
) -> Callable[[np.ndarray], bool]:
    """Function that returns whether the policy at coordinates (size,) is feasible.

    Args:
        parametrization: Parametrization of the demonstration.
        arm: Model of the arm.
        overruns: Number of rollouts in which the arm exceeded a limit that its model had kept.
        name: Id of the simulated policies.
    """

    def is_feasible(z: np.ndarray) -> bool:
        policy, _ = parametrization.policy(z, name)
        return arm.infeasible(policy, overruns) is None

    return is_feasible


def sample(
    learner: Learner,
    ran: np.ndarray,
    is_feasible: Callable[[np.ndarray], bool],
    rejections: int | None = None,
) -> tuple[np.ndarray, int]:
    """Draw a feasible sample from a learner; after 20 infeasible ones, shrink the last.

    Args:
        learner: Learner to draw from.
        ran: Coordinates that ran without a fault. Shape (size,).
        is_feasible: Returns whether coordinates are feasible; must be deterministic.
        rejections: Logged number of rejections in a replay, else None.

    Returns:
        Coordinates (size,), and the number of rejections and halvings.
    """
    draws = REJECTIONS_MAX if rejections is None else min(rejections + 1, REJECTIONS_MAX)
    for count in range(draws):
        z = learner.ask()
        if rejections is None and is_feasible(z):
            return z, count
    if rejections is not None and rejections < REJECTIONS_MAX:
        return z, rejections
    halvings = None if rejections is None else rejections - REJECTIONS_MAX
    z, halvings = shrink(z, ran, is_feasible, halvings)
    return z, REJECTIONS_MAX + halvings


def shrink(
    z: np.ndarray,
    ran: np.ndarray,
    is_feasible: Callable[[np.ndarray], bool],
    halvings: int | None = None,
) -> tuple[np.ndarray, int]:
    """Halve the distance from `ran` to `z` until the coordinates are feasible.

    Args:
        z: Desired coordinates. Shape (size,).
        ran: Coordinates that ran without a fault; not simulated again. Shape (size,).
        is_feasible: Returns whether coordinates are feasible; must be deterministic.
        halvings: Logged number of halvings in a replay, else None.

    Returns:
        Coordinates (size,), and the number of halvings.
    """
    nearer = [z, *(ran + 0.5**count * (z - ran) for count in range(1, HALVINGS_MAX)), ran]
    if halvings is None:
        feasible = (count for count in range(HALVINGS_MAX) if is_feasible(nearer[count]))
        halvings = next(feasible, HALVINGS_MAX)
    return nearer[halvings], halvings


class Improvement:
    """Selects trials around one demonstration and learns from their records.

    Attributes:
        demonstration: Id of the candidate that is learnt from.
        learner: Learner; read-only for callers.
        practised: Number of finished trials of the practice, including dropped ones.

    Args:
        records: Rollouts of the session so far; those of this demonstration are learnt from.
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
        margins = task.margins if task.declares("errors", "margins") else lambda record: ()
        self._rule = StoppingRule(settings.practice, margins, task.margin_scatter)
        self._error_model = task.error_model(parametrization, arm.foresee)
        self.learn_again(records)

    @property
    def answer(self) -> np.ndarray:
        """Answer if the session stopped now: the mean under test or the latest. Shape (size,)."""
        return self.learner.mean if self._rule.z is None else self._rule.z

    @property
    def confirmed(self) -> str:
        """Why a mean is confirmed, see `StoppingRule`; empty while none is."""
        return self._rule.complete

    @property
    def streak(self) -> int:
        """Number of successes in a row of the mean being confirmed."""
        return self._rule.count

    def learn_again(self, records: Sequence[Record]) -> None:
        """Start a new learner and feed it all rollouts of the demonstration, in their order."""
        parametrization, task = self.parametrization, self._task
        start = self._arm.tool_position(parametrization.policy0.q_start)
        model = task.model(parametrization, start) if task.declares("model") else None
        size, corrects = parametrization.size, bool(task.corrections)
        self.learner = self._settings.make_learner(
            size, self._rng, model, self._error_model, corrects
        )
        for record in records:
            if record.demonstration == self.demonstration:
                self._tell(record)
                if record.adjustment and isinstance(self.learner, MeasuringLearner):
                    self.learner.trust_returns()

    def begin(self, reproduction: Record) -> str:
        """Let the mean be run next if the reproduction succeeded; returns a remark for the log."""
        return self._rule.add(reproduction)

    def forget_success(self, record: Record) -> None:
        """Restart the stopping rule if this record was one of its successes."""
        self._rule.forget(record)

    def draw(self, past: Past, rejections: int | None) -> tuple[Kind, np.ndarray, int, str]:
        """Next trial: the mean being confirmed, the current mean, or an exploration.

        Args:
            past: Rollouts of the session so far.
            rejections: Logged number of rejections in a replay, else None; see `sample`.

        Returns:
            Kind, coordinates (size,), number of rejections and purpose.
        """
        rule, settings = self._rule, self._settings.practice
        if rule.z is not None:
            return (
                "mean",
                rule.z,
                0,
                f"confirms the mean policy, {rule.count + 1} of at most {settings.confirm}",
            )
        every = settings.mean_every
        if rule.mean_is_due or (every > 0 and (self.practised + 1) % every == 0):
            mean = self.shrunk(self.learner.mean, past, rejections)
            return "mean", *mean, "the mean policy, without exploration"
        z, count = sample(self.learner, *self._feasible(past), rejections)
        if count == 0 and np.array_equal(z, self.learner.mean):  # drawn without exploration
            return "mean", z, count, "the mean policy, without exploration"
        return "explore", z, count, "explores"

    def shrunk(self, z: np.ndarray, past: Past, rejections: int | None) -> tuple[np.ndarray, int]:
        """Coordinates shrunk until they are feasible, and the number of halvings; see `draw`."""
        return shrink(z, *self._feasible(past), rejections)

    def add(self, record: Record) -> str:
        """Learn from a record of an exploration or a mean; returns a remark for the log."""
        self.practised += 1
        self._tell(record)
        return self._rule.add(record) or ("" if record.ret is not None else "dropped")

    def _tell(self, record: Record) -> None:
        """Let the learner learn from a record, if it is learnt from."""
        if record.learnt_as is None:
            return
        learner, error = self.learner, self._task.error(record.observation)
        if isinstance(learner, MeasuringLearner) and error is not None:
            learner.measure(np.array(record.z), error)
        self.learner.tell(np.array(record.learnt_as), float(record.rated_return or 0.0))

    def _feasible(self, past: Past) -> tuple[np.ndarray, Callable[[np.ndarray], bool]]:
        """Coordinates of the best policy without a fault, else 0; whether others are feasible."""
        best = past.best_without_fault(self.demonstration)
        ran = np.zeros(self.parametrization.size) if best is None else np.array(best.z)
        on_model = feasibility(self.parametrization, self._arm, past.overruns, "sample")

        def is_feasible(z: np.ndarray) -> bool:
            # The arm may exceed a limit that its model keeps, whatever margin is left there.
            return not past.ended_in_fault(self.demonstration, z.tolist()) and on_model(z)

        return ran, is_feasible
