# SPDX-License-Identifier: Apache-2.0
"""Common parts of the learners: protocols, past rollouts, weighted mean.

A learner proposes coordinates z (`ask`), a rollout is executed there, and the learner receives its
return (`tell`). Every learner is a class with a frozen pydantic model `Settings` and the
constructor of `LearnerClass`. Its state is a function of its settings, of the draws from its
generator and of the rollouts: to restore it, tell a new learner the same rollouts in order.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from pydantic import BaseModel, ConfigDict


class Learner(Protocol):
    """A learner of z in R^size, which starts at z = 0 with exploration of unit variance.

    Only `ask` draws from the learner's generator. `tell` accepts coordinates that `ask` did not
    propose: a demonstration, the mean, a corrected sample.
    """

    size: int

    @property
    def mean(self) -> np.ndarray:
        """Current estimate, without exploration noise. Shape (size,)."""

    def ask(self) -> np.ndarray:
        """Draw the next coordinates to try. Shape (size,)."""

    def tell(self, z: np.ndarray, ret: float) -> None:
        """Learn from a rollout.

        Args:
            z: Coordinates of the rollout. Shape (size,).
            ret: Return of the rollout, >= 0.

        Raises:
            ValueError: If z or `ret` is not finite, `ret` is negative or z has another shape; the
                learner is unchanged then.
        """


@runtime_checkable
class MeasuringLearner(Protocol):
    """A learner that is also told the vector error of a rollout, where its task measures one."""

    def measure(self, z: np.ndarray, error: np.ndarray) -> None:
        """Learn the error of the rollout that is told next.

        Args:
            z: Coordinates that were executed, without corrections in hindsight. Shape (size,).
            error: Error in units of its tolerances, as in `ErrorModel`. Shape (m,).
        """

    def trust_returns(self) -> None:
        """Learn from returns alone from now on: what a person has rated is not in the error."""


class Prediction(NamedTuple):
    """What an `ErrorModel` predicts."""

    error: np.ndarray  # [tolerances], shape (m,)
    limit_excess: np.ndarray  # share by which each limit is exceeded, below 0 if kept, shape (c,)
    # Change of the error by one standard deviation of each number that the model only assumes, such
    # as a friction, shape (m, k), or (1, 0) for none
    uncertain: np.ndarray = np.empty((1, 0))


class ErrorModel(Protocol):
    """A predictor of the vector error of a rollout: what is to become 0, such as a landing error.

    Errors are in units of their tolerances: of at most 1, a rollout is as good as is useful.
    A component that has no value, such as the landing of what was not thrown, is NaN.

    Attributes:
        directions: Shifts of z that change the error, each as large as a large correction is; a
            learner searches along them first. Shape (d, size).
        modes: Smooth changes of the whole movement, moved together with these where that does
            not suffice, each by a standard deviation of the exploration. Shape (k, size).
        slopes: Rough change of the error by each. Shape (m, d).
    """

    directions: np.ndarray
    modes: np.ndarray
    slopes: np.ndarray

    @property
    def predict(self) -> Callable[[np.ndarray], Prediction | None] | None:
        """Function of z (size,) alone, None where the error is unknown; None for slopes only."""


class LearnerClass(Protocol):
    """Class of a learner, registered in the entry-point group `wam_power_ros.learners`.

    Attributes:
        needs_error_model: Whether the constructor needs an `ErrorModel`; if not, it accepts none.
            False if left out.
        needs_corrections: True if it learns from the task's corrections alone; may be left out.
    """

    Settings: Any

    def __call__(
        self,
        size: int,
        settings: Any,  # noqa: ANN401 - the class's own `Settings`
        rng: np.random.Generator,
        model: ErrorModel | None = None,
    ) -> Learner:
        """Construct a learner of `size` parameters, with an instance of `Settings`.

        Exploration is drawn from `rng`; a model is given if and only if it is needed.

        Raises:
            ValueError: If `size` is too small, or a model is missing or unused.
        """


def needs_errors(learner: Any) -> bool:  # noqa: ANN401 - a `LearnerClass`
    """Whether a learner learns from the errors of rollouts, as measured or as corrections."""
    return hasattr(learner, "measure") or getattr(learner, "needs_corrections", False)


class LearnerSettings(BaseModel):
    """Settings of a learner: frozen, without unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Rollouts:
    """Past rollouts, oldest first.

    Attributes:
        z: Coordinates, read-only. Shape (m, size).
        returns: Returns, read-only. Shape (m,).
    """

    z: np.ndarray
    returns: np.ndarray

    def __init__(self, size: int) -> None:
        """Start without rollouts; z has `size` elements."""
        self._size = size
        self.clear()

    def __len__(self) -> int:
        return len(self.returns)

    def elite(self, sigma: int) -> tuple[np.ndarray, np.ndarray]:
        """The `sigma` rollouts that `best_first` puts first, oldest first.

        Returns:
            Coordinates and returns. Shapes (k, size) and (k,), k at most `sigma`.
        """
        indices = np.sort(best_first(self.returns)[:sigma])
        return self.z[indices], self.returns[indices]

    def add(self, z: np.ndarray, ret: float) -> None:
        """Append a copy of a rollout.

        Raises:
            ValueError: As `Learner.tell`.
        """
        z = np.array(z, dtype=float)
        if z.shape != (self._size,) or not np.isfinite(z).all():
            raise ValueError(f"z must be finite and of shape ({self._size},), got {z.shape}: {z}")
        if not (np.isfinite(ret) and ret >= 0.0):
            raise ValueError(f"a return must be finite and >= 0, got {ret}")
        self.z = _read_only(np.vstack([self.z, z]))
        self.returns = _read_only(np.append(self.returns, ret))

    def clear(self) -> None:
        """Discard all rollouts to start the next batch; arrays given out keep their values."""
        self.z = _read_only(np.empty((0, self._size)))
        self.returns = _read_only(np.empty(0))


class GaussianLearner(ABC):
    """Base class of the learners: Gaussian exploration about the mean.

    A subclass defines `_update`, which computes the mean from past rollouts, and `Settings` if it
    has any of its own.
    """

    Settings: type[LearnerSettings] = LearnerSettings
    needs_error_model = False
    size_min = 1
    settings: LearnerSettings

    def __init__(
        self,
        size: int,
        settings: LearnerSettings,
        rng: np.random.Generator,
        model: ErrorModel | None = None,
    ) -> None:
        """Start at z = 0; see `LearnerClass`."""
        name = type(self).__name__
        if size < self.size_min:
            raise ValueError(f"size is {size}, {name} needs at least {self.size_min}")
        if (model is not None) != self.needs_error_model:
            raise ValueError(f"{name} {'needs a' if self.needs_error_model else 'uses no'} model")
        self.size = size
        self.settings = settings
        self._rng = rng
        self._model: Any = model  # an `ErrorModel` where it is needed
        self._rollouts = Rollouts(size)
        self._mean = np.zeros(size)
        self._noise: float | np.ndarray = 1.0  # standard deviation of the exploration

    @property
    def mean(self) -> np.ndarray:
        """Current estimate, without exploration noise. Shape (size,)."""
        return self._mean.copy()

    def ask(self) -> np.ndarray:
        """Draw the next coordinates, the mean plus noise. Shape (size,)."""
        return self._mean + self._noise * self._rng.standard_normal(self.size)

    def tell(self, z: np.ndarray, ret: float) -> None:
        """Learn from a rollout; see `Learner.tell`."""
        self._rollouts.add(z, ret)
        self._update()

    @abstractmethod
    def _update(self) -> None:
        """Update mean and noise after a rollout was added to `_rollouts`."""


def _read_only(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


def best_first(returns: np.ndarray) -> np.ndarray:
    """Indices by decreasing return; of equal returns, the later rollout first."""
    newest_first = np.arange(len(returns))[::-1]
    return newest_first[np.argsort(-returns[newest_first], kind="stable")]


def weighted_mean(rows: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted mean of rows (k, n). Shape (n,).

    Summed row by row instead of by BLAS, whose order of summation depends on the processor.
    """
    return (weights[:, np.newaxis] * rows).sum(axis=0) / weights.sum()


def generator_state(rng: np.random.Generator) -> dict[str, Any]:
    """State of a PCG64 generator as JSON data; its integers have up to 128 bits.

    Raises:
        ValueError: If the bit generator is not PCG64.
    """
    state = dict(rng.bit_generator.state)
    if state["bit_generator"] != "PCG64":
        raise ValueError(f"bit generator {state['bit_generator']!r} must be 'PCG64'")
    return state
