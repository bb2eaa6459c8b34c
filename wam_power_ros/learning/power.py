# SPDX-License-Identifier: Apache-2.0
"""PoWER, policy learning by weighting exploration with the returns ([Kormushev2010], Eqs. 2-3).

A learner is asked for coordinates z and told the return they had; between the two a robot may take
an hour. Every learner has the methods of `Learner`, keeps all it knows in `state()`, and takes its
random generator from outside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

Weights = Literal["return", "sharpened"]
SIZES = (2, 3, 4, 6, 8, 12, 16, 24)  # of an elite that `choose_sigma` has to choose from
_FEW = 8  # rollouts that are too few to choose by


class Learner(Protocol):
    """What the practice of a skill needs of a learner of z in R^size.

    `ask` draws from the learner's generator; `tell` does not, and accepts points that were never
    asked for (a demonstration, the mean, a corrected sample).
    """

    size: int

    @property
    def mean(self) -> np.ndarray:
        """The policy without exploration, as of all that was told. Shape (size,)."""
        ...

    def ask(self) -> np.ndarray:
        """Draw the next coordinates to try. Shape (size,)."""
        ...

    def tell(self, z: np.ndarray, ret: float) -> None:
        """Learn that z, of shape (size,), had the return `ret`."""
        ...

    def state(self) -> dict[str, Any]:
        """All of the learner, generator included, as data for JSON."""
        ...


class PowerSettings(BaseModel):
    """Settings of PoWER.

    Attributes:
        sigma: size of the elite, the number of best past rollouts that make the mean; "auto": of
            `choose_sigma`, anew after every rollout.
        weights: "return" weights them with their returns (the paper), "sharpened" with
            exp((R - R_max) / (sharpness (R_max - R_min))), R_min and R_max those of the elite.
        sharpness: see `weights`.
        decay: factor on the exploration for each rollout told; 1 for none (the paper).
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    sigma: Annotated[int, Field(ge=1)] | Literal["auto"] = 6
    weights: Weights = "return"
    sharpness: float = Field(default=0.3, gt=0.0, allow_inf_nan=False)
    decay: float = Field(default=1.0, gt=0.0, le=1.0)


def power_update(
    theta: np.ndarray,
    rollouts: np.ndarray,
    returns: np.ndarray,
    sigma: int,
    weights: Weights = "return",
    sharpness: float = 0.3,
) -> np.ndarray:
    """Return-weighted mean of the explored offsets of the best rollouts [Kormushev2010, Eqs. 2-3].

        theta' = theta + sum_k (theta_k - theta) R_k / sum_k R_k,

    with k over the `sigma` rollouts of highest return among ALL past ones. theta cancels: theta' is
    the weighted mean of the elite, so the order of the rollouts does not matter. Of equal returns
    at the elite's edge the later rollouts are taken: they were sampled nearest to the current mean.

    Args:
        theta: current parameters. Shape (n,)
        rollouts: parameters of the past rollouts, oldest first. Shape (m, n)
        returns: their returns, none negative. Shape (m,)
        sigma: size of the elite.
        weights: see `PowerSettings`.
        sharpness: see `PowerSettings`.

    Returns:
        New parameters. Shape (n,). No argument is modified.

    Raises:
        ValueError: shapes that do not match, a return that is negative or not finite, or no
            positive return at all: there is nothing to weight with.
    """
    theta = np.asarray(theta, dtype=float)
    rollouts = np.asarray(rollouts, dtype=float)
    returns = np.asarray(returns, dtype=float)
    if theta.ndim != 1 or rollouts.shape != (len(returns), len(theta)) or returns.ndim != 1:
        raise ValueError(
            f"theta {theta.shape}, rollouts {rollouts.shape} and returns {returns.shape} "
            "must be (n,), (m, n) and (m,)"
        )
    if sigma < 1:
        raise ValueError(f"sigma is {sigma}, an elite has at least one rollout")
    bad = ~(np.isfinite(returns) & (returns >= 0.0))
    if bad.any():
        raise ValueError(f"returns must be finite and >= 0, got {returns[bad][:3]}")
    if not (returns > 0.0).any():
        raise ValueError(f"none of {len(returns)} returns is positive")
    elite = _best_first(returns)[:sigma]
    weight = _weights(returns[elite], weights, sharpness)  # (k,)
    offsets = rollouts[elite] - theta  # (k, n)
    # Summed row by row and not by BLAS, whose order of summation depends on the processor.
    return theta + (weight[:, np.newaxis] * offsets).sum(axis=0) / weight.sum()


def choose_sigma(rollouts: np.ndarray, returns: np.ndarray) -> int:
    """Size of the elite whose mean promises most, judged by rollouts that had no part in it. Ours.

    For each size s, and each rollout k left out in turn, m is the return-weighted mean of the s
    best of the others and c the plain mean of the others:

        d_k = m - c,    p_k = (theta_k - c) . d_k / |d_k|,
        gain(s) = mean_k |d_k| cov_k(p, R) / var_k(p),

    how far the elite leads away from where was searched, times how much the return rises along that
    way for the rollouts left out. A small elite leads far, and where returns have no noise it leads
    uphill; but if its best rollouts were only lucky, the one left out does not agree, the slope is
    small and a larger elite wins, which averages luck out.

    Args:
        rollouts: parameters of the past rollouts, oldest first. Shape (m, n)
        returns: their returns, none negative. Shape (m,)

    Returns:
        The size out of `SIZES` of the highest gain, the smaller one of equals; 6, the paper's,
        for fewer than 8 rollouts or when nothing can be told from them.
    """
    count = len(returns)
    if count < _FEW:
        return 6
    order = _best_first(returns)
    rollouts, returns = rollouts[order], returns[order]
    sums = np.cumsum(returns[:, np.newaxis] * rollouts, axis=0)  # of the first 1, 2, ... best
    weights = np.cumsum(returns)
    centre = (rollouts.sum(axis=0) - rollouts) / (count - 1)  # (m, n), of all but k
    best, chosen = 0.0, 6
    for size in SIZES:
        if size >= count - 1:
            break
        inside = np.arange(count) < size  # then the next one takes the place of k
        total = np.where(inside, weights[size] - returns, weights[size - 1])
        if not (total > 0.0).all():
            continue
        own = returns[:, np.newaxis] * rollouts
        lead = np.where(inside[:, np.newaxis], sums[size] - own, sums[size - 1])
        lead = lead / total[:, np.newaxis] - centre  # d_k, (m, n)
        length = np.sqrt((lead**2).sum(axis=1))
        if not (length > 0.0).all():
            continue
        along = ((rollouts - centre) * lead).sum(axis=1) / length  # p_k
        spread = along - along.mean()
        if not (variance := float((spread**2).mean())) > 0.0:
            continue
        gain = float(length.mean()) * float((spread * (returns - returns.mean())).mean()) / variance
        if gain > best:
            best, chosen = gain, size
    return chosen


def _best_first(returns: np.ndarray) -> np.ndarray:
    """Indices by falling return; of equal returns the later rollout is first."""
    newest_first = np.arange(len(returns))[::-1]
    return newest_first[np.argsort(-returns[newest_first], kind="stable")]


def _weights(returns: np.ndarray, kind: Weights, sharpness: float) -> np.ndarray:
    """Weights of an elite, the largest being one: their sum needs no guard. Shape (k,)."""
    best = returns.max()
    if kind == "return":
        return returns / best
    if kind == "sharpened":
        spread = best - returns.min()
        if spread == 0.0:
            return np.ones_like(returns)
        return np.exp((returns - best) / (sharpness * spread))
    raise ValueError(f"weights {kind!r} is not one of return, sharpened")


class Power:
    """PoWER behind ask and tell: Gaussian exploration of unit noise about `mean`."""

    def __init__(self, size: int, settings: PowerSettings, rng: np.random.Generator) -> None:
        """Start at z = 0, having been told nothing.

        Args:
            size: number of parameters.
            settings: see there.
            rng: source of the exploration; used by `ask` alone.
        """
        if size < 1:
            raise ValueError(f"size is {size}, there must be at least one parameter")
        self.size = size
        self.settings = settings
        self._rng = rng
        self._told: list[np.ndarray] = []
        self._returns: list[float] = []
        self._mean = np.zeros(size)

    @property
    def mean(self) -> np.ndarray:
        """Return-weighted mean of the elite, z = 0 until a positive return was told. (size,)."""
        return self._mean.copy()

    @property
    def noise(self) -> float:
        """Standard deviation of the next exploration, in units of z."""
        return self.settings.decay ** len(self._returns)

    @property
    def sigma(self) -> int:
        """Size of the elite that made the mean, or will make the first."""
        if self.settings.sigma != "auto":
            return self.settings.sigma
        return choose_sigma(np.array(self._told), np.array(self._returns))

    @property
    def count(self) -> int:
        """Number of rollouts told."""
        return len(self._returns)

    def ask(self) -> np.ndarray:
        """Draw the next coordinates, the mean plus noise. Shape (size,)."""
        return self._mean + self.noise * self._rng.standard_normal(self.size)

    def tell(self, z: np.ndarray, ret: float) -> None:
        """Learn that z had return `ret`.

        Args:
            z: coordinates of the rollout, asked for or not. Shape (size,)
            ret: its return, >= 0.

        Raises:
            ValueError: z or `ret` cannot be learnt from; nothing has changed then.
        """
        check_rollout(z, ret, self.size)
        self._told.append(np.array(z, dtype=float))  # the caller may do with his as he likes
        self._returns.append(float(ret))
        self._update()

    def state(self) -> dict[str, Any]:
        """All of the learner as data for JSON, generator included; `from_state` is its inverse."""
        return state_of("power", self.settings, self._told, self._returns, self.size, self._rng)

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> Power:
        """Learner that goes on exactly where the one that gave `state` was.

        Raises:
            ValueError: not the state of a PoWER learner.
        """
        if state.get("learner") != "power":
            raise ValueError(f"state of learner {state.get('learner')!r}, expected 'power'")
        settings = PowerSettings.model_validate(state["settings"])
        learner = cls(int(state["size"]), settings, restore_generator(state["generator"]))
        tell_again(learner, state)
        return learner

    def _update(self) -> None:
        if max(self._returns) > 0.0:
            self._mean = power_update(
                np.zeros(self.size),
                np.stack(self._told),
                np.array(self._returns),
                self.sigma,
                self.settings.weights,
                self.settings.sharpness,
            )


def check_rollout(z: np.ndarray, ret: float, size: int) -> None:
    """Check what a learner of `size` parameters is told; see `Learner.tell`.

    Raises:
        ValueError: it cannot be learnt from.
    """
    z = np.array(z, dtype=float)
    if z.shape != (size,) or not np.isfinite(z).all():
        raise ValueError(f"z must be finite and of shape ({size},), got {z.shape}: {z}")
    if not (np.isfinite(ret) and ret >= 0.0):
        raise ValueError(f"a return must be finite and >= 0, got {ret}")


def state_of(
    kind: str,
    settings: BaseModel,
    told: Sequence[np.ndarray],
    returns: Sequence[float],
    size: int,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """`Learner.state` of a learner that follows from its settings and what it was told."""
    return {
        "learner": kind,
        "size": size,
        "settings": settings.model_dump(mode="json"),
        "z": [z.tolist() for z in told],
        "returns": list(returns),
        "generator": generator_state(rng),
    }


def tell_again(learner: Learner, state: Mapping[str, Any]) -> None:
    """Tell a learner all that the one of this `state` was told.

    Raises:
        ValueError: not as many returns as rollouts, or one that cannot be learnt from.
    """
    if len(state["z"]) != len(state["returns"]):
        raise ValueError(f"{len(state['z'])} rollouts but {len(state['returns'])} returns")
    for z, ret in zip(state["z"], state["returns"], strict=True):
        learner.tell(z, ret)


def generator_state(rng: np.random.Generator) -> dict[str, Any]:
    """State of a PCG64 generator as data for JSON; its integers have up to 128 bits.

    Raises:
        ValueError: the generator is of another kind.
    """
    state = rng.bit_generator.state
    if state["bit_generator"] != "PCG64":
        raise ValueError(f"bit generator {state['bit_generator']!r}, expected 'PCG64'")
    return {
        "bit_generator": "PCG64",
        "state": {key: int(value) for key, value in state["state"].items()},
        "has_uint32": int(state["has_uint32"]),
        "uinteger": int(state["uinteger"]),
    }


def restore_generator(state: Mapping[str, Any]) -> np.random.Generator:
    """Generator in the state that `generator_state` gave.

    Raises:
        ValueError: not the state of a PCG64 generator.
    """
    bit_generator = np.random.PCG64()
    try:
        bit_generator.state = dict(state)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"not the state of a PCG64 generator: {error!r}") from error
    return np.random.Generator(bit_generator)
