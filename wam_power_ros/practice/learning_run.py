# SPDX-License-Identifier: Apache-2.0
"""Learning from one demonstration by a learner, with feasible sampling.

Coordinates z (size,) are infeasible when the simulation of their policy on the rigid-body model
ends in a fault; whether they are must be a function of z alone. Infeasible samples are rejected;
after 20 rejections, the last is shrunk to feasible coordinates. The number of rejections and
halvings is logged: a replay passes it in, and nothing is simulated; otherwise it is None.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np

from wam_power_ros.faults import Fault
from wam_power_ros.learning.learner import Learner, MeasuringLearner
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import SimulatedRollout
from wam_power_ros.practice.best_policy import best_without_fault, ended_by_fault, limit_stops
from wam_power_ros.practice.session_log import Record, Trial
from wam_power_ros.practice.settings import SessionSettings
from wam_power_ros.practice.stopping_rule import StoppingRule
from wam_power_ros.tasks.task import Task

REJECTIONS_MAX = 20
HALVINGS_MAX = 5  # of the distance from coordinates that ran without a fault to infeasible ones


class ArmModel(Protocol):
    """Model of the arm as a practice needs it.

    Both methods must be functions of their arguments: a replay depends on it.
    """

    def infeasible(self, policy: Policy, limit_stops: int = 0) -> Fault | None:
        """Fault in which a simulated execution of a policy ends, None if it is feasible.

        `limit_stops` counts the rollouts in which the arm exceeded a limit that its model kept.
        """

    def simulate(self, policy: Policy) -> SimulatedRollout | None:
        """Simulated execution of a policy; None if it ends in a fault."""


def feasibility(
    parametrization: Parametrization, arm: ArmModel, limit_stops: int, name: str
) -> Callable[[np.ndarray], bool]:
    """Function of z (size,): whether its policy, simulated under a name, is feasible."""

    def is_feasible(z: np.ndarray) -> bool:
        policy, _ = parametrization.policy(z, name)
        return arm.infeasible(policy, limit_stops) is None

    return is_feasible


def sample(
    learner: Learner,
    ran: Callable[[], np.ndarray],
    is_feasible: Callable[[np.ndarray], bool],
    rejections: int | None = None,
) -> tuple[np.ndarray, int]:
    """Draw a feasible sample from a learner; after 20 infeasible ones, `shrink` the last.

    Returns:
        Coordinates (size,), and the number of rejections and halvings.
    """

    def candidates() -> Iterator[np.ndarray]:
        for _ in range(REJECTIONS_MAX):
            z = learner.ask()
            yield z
        yield from _halved(z, ran)

    return _first(candidates(), is_feasible, rejections)


def shrink(
    z: np.ndarray, ran: np.ndarray, is_feasible: Callable[[np.ndarray], bool]
) -> tuple[np.ndarray, int]:
    """Halve the distance from `ran`, which ran without a fault, to z until z is feasible.

    Returns:
        Coordinates (size,), `ran` as the last resort, and the number of halvings.
    """
    return _first(_halved(z, lambda: ran), is_feasible, None)


def _halved(z: np.ndarray, ran: Callable[[], np.ndarray]) -> Iterator[np.ndarray]:
    yield z
    end = ran()
    yield from (end + 0.5**count * (z - end) for count in range(1, HALVINGS_MAX))
    yield end


def _first(
    candidates: Iterable[np.ndarray], is_feasible: Callable[[np.ndarray], bool], index: int | None
) -> tuple[np.ndarray, int]:
    """Candidate of an index, without one the first feasible or else the last; and its index."""
    for count, z in enumerate(candidates):
        if count == index or (index is None and is_feasible(z)):
            break
    return z, count


class LearningRun:
    """Selects trials around one demonstration and learns from their records.

    Attributes:
        practised: Number of finished trials of the practice, including dropped ones.
    """

    def __init__(
        self,
        parametrization: Parametrization,
        settings: SessionSettings,
        task: Task,
        rng: np.random.Generator,
        arm: ArmModel,
        records: Sequence[Record],
        practised: int = 0,
    ) -> None:
        """Learn from the records of this demonstration; the caller appends to those it gives."""
        self.demonstration = parametrization.policy0.id
        self.parametrization = parametrization
        self.practised = practised
        self._settings, self._task, self._arm, self._rng = settings, task, arm, rng
        self._records = records
        known = task.declares("errors", "success_margins")
        margins = task.success_margins if known else lambda record: ()
        self.rule = StoppingRule(settings.practice, margins, task.scatter)
        self._error_model = task.error_model(parametrization, arm.simulate)
        self.learn_again()

    @property
    def answer(self) -> np.ndarray:
        """Answer if the session stopped now: the mean under test or the latest. Shape (size,)."""
        return self.learner.mean if self.rule.z is None else self.rule.z

    def learn_again(self) -> None:
        """Start a new learner and feed it all rollouts of the demonstration, in their order."""
        size, model = self.parametrization.size, self._error_model
        corrects = bool(self._task.corrections)
        self.learner = self._settings.make_learner(size, self._rng, model, corrects)
        for record in self._records:
            if record.demonstration == self.demonstration:
                self._tell(record)
                if record.adjustment and isinstance(self.learner, MeasuringLearner):
                    self.learner.trust_returns()

    def draw(self, number: int, rejections: int | None) -> Trial:
        """Next trial: the mean being confirmed, the current mean, or an exploration."""
        own, rule, settings = self.parametrization, self.rule, self._settings.practice
        if rule.z is not None:
            known = f"{rule.successes} of {rule.runs} succeeded"
            return Trial.at(number, own, "mean", rule.z, f"confirms the mean policy: {known}")
        every = settings.mean_every
        if rule.mean_is_due or (every > 0 and (self.practised + 1) % every == 0):
            z, count, is_mean = *self.shrunk(self.learner.mean, rejections), True
        else:
            z, count = sample(self.learner, self._ran, self._is_feasible, rejections)
            is_mean = count == 0 and np.array_equal(z, self.learner.mean)  # without exploration
        if is_mean:
            purpose = "the mean policy, without exploration"
            return Trial.at(number, own, "mean", z, purpose, count)
        return Trial.at(number, own, "explore", z, "explores", count)

    def shrunk(self, z: np.ndarray, halvings: int | None) -> tuple[np.ndarray, int]:
        """Coordinates shrunk until they are feasible, and the number of halvings; see `shrink`."""
        return _first(_halved(z, self._ran), self._is_feasible, halvings)

    def add(self, record: Record) -> str:
        """Learn from a record of an exploration or a mean; returns a remark for the log."""
        self.practised += 1
        self._tell(record)
        return self.rule.add(record) or ("" if record.ret is not None else "dropped")

    def _tell(self, record: Record) -> None:
        """Let the learner learn from a record, if it is learnt from."""
        if record.z_corrected is None:
            return
        learner, error = self.learner, self._task.error(record.observation)
        if isinstance(learner, MeasuringLearner) and error is not None:
            learner.measure(np.array(record.z), error)
        self.learner.tell(np.array(record.z_corrected), float(record.rated_return or 0.0))

    def _ran(self) -> np.ndarray:
        """Coordinates of the best policy that ran without a fault, else 0. Shape (size,)."""
        best = best_without_fault(self._records, self.demonstration)
        return np.zeros(self.parametrization.size) if best is None else np.array(best.z)

    def _is_feasible(self, z: np.ndarray) -> bool:
        """Whether neither the arm nor its model has ended in a fault at coordinates z (size,)."""
        # The arm may exceed a limit that its model keeps, whatever margin is left there.
        if z.tolist() in ended_by_fault(self._records, self.demonstration):
            return False
        exceeded = limit_stops(self._records)
        return feasibility(self.parametrization, self._arm, exceeded, "sample")(z)
