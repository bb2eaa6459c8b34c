# SPDX-License-Identifier: Apache-2.0
"""Other learners behind the ask and tell of `power.Learner`, to compare PoWER with.

    learner = Search(size, Pi2(population=10), rng)

A settings class for each method, one `Search` for all. A method is a function of what was told and
of the generator's draws, so `Search.state` resumes every one of them exactly.

Where a formula was not at hand to be looked up it is cited without an equation number. Several of
these methods take any return; `tell` refuses negative ones all the same, as PoWER needs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Protocol

import cmaes
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from wam_power_ros.learning.power import (
    Learner,
    Power,
    Weights,
    check_rollout,
    power_update,
    restore_generator,
    state_of,
    tell_again,
)
from wam_power_ros.learning.screened_power import Model, Screened, ScreenedPower


class _Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class ShapedPower(_Settings):
    """PoWER with a warm-up, rank weights and mirrored sampling; all three are not in the paper.

    Attributes:
        sigma: size of the elite.
        weights: those of `power_update`, or "rank": w_i = ln(sigma + 1/2) - ln(i).
        decay: factor on the exploration for each rollout told after the warm-up.
        warm_up: rollouts about z = 0 at first; the mean stays there meanwhile.
        mirrored: every second rollout is the last one mirrored at the mean it was drawn about.
    """

    kind: Literal["shaped_power"] = "shaped_power"
    sigma: int = Field(default=3, ge=1)
    weights: Weights | Literal["rank"] = "rank"
    decay: float = Field(default=0.965, gt=0.0, le=1.0)
    warm_up: int = Field(default=10, ge=0)
    mirrored: bool = True


class AdaptivePower(_Settings):
    """PoWER with the variance of each parameter learnt as well, Kober's sample code.

    Attributes:
        sigma: size of the elite of the mean.
        variance_sigma: size of the elite of the variance; larger, lest it shrinks to nothing.
        smallest: lower bound of the variances, of the initial one.
        largest: upper bound of the variances, of the initial one.
    """

    kind: Literal["adaptive_power"] = "adaptive_power"
    sigma: int = Field(default=10, ge=1)
    variance_sigma: int = Field(default=100, ge=1)
    smallest: float = Field(default=0.1, gt=0.0, le=1.0)
    largest: float = Field(default=10.0, ge=1.0, allow_inf_nan=False)


class Pi2(_Settings):
    """PI2-BB: path integrals as black-box optimisation [Stulp & Sigaud 2013].

    Attributes:
        population: rollouts of an update.
        eliteness: h of the weights exp(h (R - R_max) / (R_max - R_min)).
        decay: factor on the exploration for each update.
    """

    kind: Literal["pi2_bb"] = "pi2_bb"
    population: int = Field(default=10, ge=2)
    eliteness: float = Field(default=10.0, gt=0.0, allow_inf_nan=False)
    decay: float = Field(default=0.9, gt=0.0, le=1.0)


class Cma(_Settings):
    """CMA-ES of the `cmaes` library [Hansen 2016].

    Attributes:
        population: rollouts of a generation; the library's 4 + 3 ln(size) when omitted.
    """

    kind: Literal["cma_es"] = "cma_es"
    population: int | None = Field(default=None, ge=5)


class Reinforce(_Settings):
    """Episodic REINFORCE with the baseline of least variance [Williams 1992].

    Attributes:
        population: rollouts of an update.
        rate: of learning; steps are in units of the exploration, see `_Gradient`.
        decay: factor on the exploration for each update.
    """

    kind: Literal["reinforce"] = "reinforce"
    population: int = Field(default=10, ge=2)
    rate: float = Field(default=1.0, gt=0.0, allow_inf_nan=False)
    decay: float = Field(default=0.95, gt=0.0, le=1.0)


class Enac(_Settings):
    """Episodic natural actor-critic [Peters & Schaal 2008].

    Attributes:
        population: rollouts of an update; below size + 1 the smallest gradient that explains
            the returns is taken.
        rate: of learning, as that of `Reinforce`.
        decay: factor on the exploration for each update.
    """

    kind: Literal["enac"] = "enac"
    population: int = Field(default=20, ge=2)
    rate: float = Field(default=1.0, gt=0.0, allow_inf_nan=False)
    decay: float = Field(default=0.9, gt=0.0, le=1.0)


class RandomSearch(_Settings):
    """The best of independent draws about z = 0: what a learner has to beat."""

    kind: Literal["random"] = "random"


Settings = Annotated[
    ShapedPower | AdaptivePower | Pi2 | Cma | Reinforce | Enac | RandomSearch | Screened,
    Field(discriminator="kind"),
]
_SETTINGS: TypeAdapter[Settings] = TypeAdapter(Settings)


class _Method(Protocol):
    """A method of search; `learn` is given checked arguments that nobody else keeps."""

    mean: np.ndarray

    def draw(self, rng: np.random.Generator) -> np.ndarray: ...

    def learn(self, z: np.ndarray, ret: float) -> None: ...


class Search:
    """Any of the methods above behind ask and tell, starting at z = 0 with unit noise."""

    def __init__(
        self,
        size: int,
        settings: Settings,
        rng: np.random.Generator,
        model: Model | None = None,
    ) -> None:
        """Start, having been told nothing.

        Args:
            size: number of parameters.
            settings: of the method, and which one.
            rng: source of the exploration; used by `ask` alone.
            model: what `Screened` screens with, having learnt nothing; no other method has one.

        Raises:
            ValueError: no parameter, fewer than two for CMA-ES, or a model missing or in vain.
        """
        if isinstance(settings, Screened) != (model is not None):
            raise ValueError(
                f"{settings.kind} with model {model}: 'screened' needs one, others none"
            )
        least = 2 if isinstance(settings, Cma) else 1
        if size < least:
            raise ValueError(f"size is {size}, {settings.kind} needs at least {least}")
        self.size = size
        self.settings = settings
        self._rng = rng
        self._told: list[np.ndarray] = []
        self._returns: list[float] = []
        self._method = _method(size, settings, model)

    @property
    def mean(self) -> np.ndarray:
        """The policy without exploration, z = 0 at first. Shape (size,)."""
        return self._method.mean.copy()

    @property
    def count(self) -> int:
        """Number of rollouts told."""
        return len(self._returns)

    def ask(self) -> np.ndarray:
        """Draw the next coordinates. Shape (size,)."""
        return self._method.draw(self._rng)

    def tell(self, z: np.ndarray, ret: float) -> None:
        """Learn that z had return `ret`.

        Args:
            z: coordinates of the rollout, asked for or not. Shape (size,)
            ret: its return, >= 0.

        Raises:
            ValueError: z or `ret` cannot be learnt from; nothing has changed then.
        """
        check_rollout(z, ret, self.size)
        z = np.array(z, dtype=float)
        self._told.append(z)
        self._returns.append(float(ret))
        self._method.learn(z, float(ret))

    def state(self) -> dict[str, Any]:
        """All of the learner as data for JSON, generator included; `from_state` is its inverse."""
        settings, told, returns = self.settings, self._told, self._returns
        return state_of(settings.kind, settings, told, returns, self.size, self._rng)

    @classmethod
    def from_state(cls, state: Mapping[str, Any], model: Model | None = None) -> Search:
        """Learner that goes on exactly where the one that gave `state` was.

        Args:
            state: of `Search.state`.
            model: as when it was begun: it is told every rollout again.

        Raises:
            ValueError: not the state of one of these learners.
        """
        settings = _SETTINGS.validate_python(state["settings"])
        learner = cls(int(state["size"]), settings, restore_generator(state["generator"]), model)
        tell_again(learner, state)
        return learner


def restore(state: Mapping[str, Any], model: Model | None = None) -> Learner:
    """The learner, PoWER or any of these, that gave `state`; `model` as of `Search.from_state`.

    Raises:
        ValueError: not the state of a learner.
    """
    if state.get("learner") == "power":
        return Power.from_state(state)
    return Search.from_state(state, model)


def _method(size: int, settings: Settings, model: Model | None) -> _Method:
    if isinstance(settings, Screened) and model is not None:
        return ScreenedPower(size, settings, model)
    if isinstance(settings, ShapedPower):
        return _ShapedPower(size, settings)
    if isinstance(settings, AdaptivePower):
        return _AdaptivePower(size, settings)
    if isinstance(settings, Pi2):
        return _Pi2(size, settings)
    if isinstance(settings, Cma):
        return _Cma(size, settings)
    if isinstance(settings, RandomSearch):
        return _RandomSearch(size)
    return _Gradient(size, settings)


def _best_first(returns: list[float]) -> np.ndarray:
    """Indices by falling return; of equal returns the later one is first, as in `power_update`."""
    newest_first = np.arange(len(returns))[::-1]
    return newest_first[np.argsort(-np.array(returns)[newest_first], kind="stable")]


def _weighted(rows: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted mean of rows (k, n), summed row by row: the same on every processor."""
    return (weights[:, None] * rows).sum(axis=0) / weights.sum()


class _ShapedPower:
    def __init__(self, size: int, settings: ShapedPower) -> None:
        self._settings = settings
        self._told: list[np.ndarray] = []
        self._returns: list[float] = []
        self._centre = np.zeros(size)  # of the pair that is under way
        self.mean = np.zeros(size)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        if self._settings.mirrored and len(self._told) % 2 == 1:
            return 2.0 * self._centre - self._told[-1]
        noise = self._settings.decay ** max(len(self._told) - self._settings.warm_up, 0)
        return self.mean + noise * rng.standard_normal(len(self.mean))

    def learn(self, z: np.ndarray, ret: float) -> None:
        if len(self._told) % 2 == 0:
            self._centre = self.mean
        self._told.append(z)
        self._returns.append(ret)
        if len(self._told) < self._settings.warm_up or max(self._returns) <= 0.0:
            return
        if self._settings.weights == "rank":
            elite = _best_first(self._returns)[: self._settings.sigma]
            rank = np.arange(1, len(elite) + 1)
            weights = np.log(self._settings.sigma + 0.5) - np.log(rank)  # [Hansen2016, (49)]
            self.mean = _weighted(np.stack(self._told)[elite], weights)  # [Kormushev2010, (2)]
        else:
            self.mean = power_update(  # [Kormushev2010, (2)-(3)]
                self.mean,
                np.stack(self._told),
                np.array(self._returns),
                self._settings.sigma,
                self._settings.weights,
            )


class _AdaptivePower:
    def __init__(self, size: int, settings: AdaptivePower) -> None:
        self._settings = settings
        self._told: list[np.ndarray] = []
        self._returns: list[float] = []
        self._variance = np.ones(size)
        self.mean = np.zeros(size)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        return self.mean + np.sqrt(self._variance) * rng.standard_normal(len(self.mean))

    def learn(self, z: np.ndarray, ret: float) -> None:
        self._told.append(z)
        self._returns.append(ret)
        if max(self._returns) <= 0.0:
            return
        elite = _best_first(self._returns)[: self._settings.variance_sigma]
        told, returns = np.stack(self._told), np.array(self._returns)
        # Kober's sample code: sigma^2 = sum R (theta_k - theta)^2 / sum R, theta the mean so far.
        weights = returns[elite] / returns.max()
        variance = _weighted((told[elite] - self.mean) ** 2, weights)
        self._variance = np.clip(variance, self._settings.smallest, self._settings.largest)
        self.mean = power_update(self.mean, told, returns, self._settings.sigma)


class _Pi2:
    def __init__(self, size: int, settings: Pi2) -> None:
        self._settings = settings
        self._batch: list[tuple[np.ndarray, float]] = []
        self._noise = 1.0
        self.mean = np.zeros(size)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        return self.mean + self._noise * rng.standard_normal(len(self.mean))

    def learn(self, z: np.ndarray, ret: float) -> None:
        self._batch.append((z, ret))
        if len(self._batch) < self._settings.population:
            return
        told = np.stack([z for z, _ in self._batch])
        returns = np.array([ret for _, ret in self._batch])
        spread = float(np.ptp(returns))
        if spread > 0.0:
            # P_k = exp(-h (S_k - S_min) / (S_max - S_min)) / sum, the cost S = -R;
            # theta = sum P_k theta_k [Stulp & Sigaud 2013].
            share = (returns - returns.max()) / spread
            self.mean = _weighted(told, np.exp(self._settings.eliteness * share))
        self._noise *= self._settings.decay
        self._batch = []


class _Cma:
    def __init__(self, size: int, settings: Cma) -> None:
        self._optimizer = cmaes.CMA(
            mean=np.zeros(size), sigma=1.0, seed=0, population_size=settings.population
        )
        self._batch: list[tuple[np.ndarray, float]] = []

    @property
    def mean(self) -> np.ndarray:
        return self._optimizer.mean

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        # The library has a generator of its own; seeded from ours each time it has nothing to keep.
        self._optimizer.reseed_rng(int(rng.integers(2**32)))
        return self._optimizer.ask()

    def learn(self, z: np.ndarray, ret: float) -> None:
        self._batch.append((z, -ret))  # it minimises
        if len(self._batch) == self._optimizer.population_size:
            self._optimizer.tell(self._batch)
            self._batch = []


class _Gradient:
    """REINFORCE and eNAC: a step along the gradient of the expected return.

    Ours: returns are divided by their standard deviation in the batch, so that one rate serves
    every scale of returns, and the step is in units of the exploration.
    """

    def __init__(self, size: int, settings: Reinforce | Enac) -> None:
        self._settings = settings
        self._batch: list[tuple[np.ndarray, float]] = []
        self._noise = 1.0
        self.mean = np.zeros(size)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        return self.mean + self._noise * rng.standard_normal(len(self.mean))

    def learn(self, z: np.ndarray, ret: float) -> None:
        self._batch.append((z, ret))
        if len(self._batch) < self._settings.population:
            return
        told = np.stack([z for z, _ in self._batch])
        returns = np.array([ret for _, ret in self._batch])
        deviation = float(returns.std())
        if deviation > 0.0:
            eps = (told - self.mean) / self._noise  # noise * grad log pi. Shape (N, n)
            scaled = (returns - returns.mean()) / deviation
            if isinstance(self._settings, Reinforce):
                # b = sum psi^2 R / sum psi^2;  grad = mean psi (R - b), each axis alone
                # [Peters & Schaal 2008, episodic REINFORCE with optimal baseline].
                square = eps**2
                baseline = (square * scaled[:, None]).sum(axis=0)
                baseline /= np.maximum(square.sum(axis=0), np.finfo(float).tiny)
                gradient = (eps * (scaled[:, None] - baseline)).mean(axis=0)
            else:
                # R_k = psi_k^T w + J_0 by least squares; w is the natural gradient
                # [Peters & Schaal 2008, eNAC].
                design = eps - eps.mean(axis=0)
                gradient = np.linalg.lstsq(design, scaled, rcond=None)[0]
            self.mean = self.mean + self._settings.rate * self._noise * gradient
        self._noise *= self._settings.decay
        self._batch = []


class _RandomSearch:
    def __init__(self, size: int) -> None:
        self._best = -1.0
        self.mean = np.zeros(size)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        return rng.standard_normal(len(self.mean))

    def learn(self, z: np.ndarray, ret: float) -> None:
        if ret > self._best:
            self._best, self.mean = ret, z
