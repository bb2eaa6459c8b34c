# SPDX-License-Identifier: Apache-2.0
"""Reaching (Eq. 4) with equal knowledge: every learner with and without the model, and a planner.

    python -m reproduction.studies equal_knowledge

The model is `ReachModel`: Eqs. 1 and 4, start and goal, but no obstacle. With it a learner draws
candidates and executes the one of the highest predicted return, fewer with every rollout.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import cmaes
import numpy as np

from reproduction.rivals.learners import RIVALS, RandomSearch
from reproduction.rivals.reach_model import ReachModel
from reproduction.studies.reaching import generator, learn_many, scales
from reproduction.studies.reaching_scenario import synthetic
from reproduction.studies.table import Row, Table
from wam_power_ros import installed
from wam_power_ros.learning.learner import Learner
from wam_power_ros.learning.parametrization import parametrization_of

HELD_OUT = range(481, 493)  # seeds not used for tuning
ROLLOUTS = 50
# Standard deviation; Eq. 4 is at most 1
NOISES = {
    "exact returns": {"noise": 0.0, "rollouts": ROLLOUTS},
    "noisy returns": {"noise": 0.02, "rollouts": ROLLOUTS},
}
CONTACT_SIGMAS = 3.0  # standard deviations from the free path's return that count as contact
CANDIDATES, HALF_LIFE = 200, 16.0  # of the first exploration; rollouts until there are half of them
GENERATIONS, POPULATION, STEP = 8, 25, 0.5  # of the planner: 200 predictions per rollout
MODEL = "return, model"  # information of a learner


class Choice(NamedTuple):
    """A learner, its settings, and the standard deviations of its exploration."""

    name: str
    settings: dict[str, Any]
    stiffness: float  # fraction of the mean stiffness
    attractor: float  # [m]


# The best of two settings that the literature suggests and of twelve explorations, on 70 tuning
# seeds, without model and noise, after 100 rollouts.
TUNED = {
    "power": Choice("power", {"sigma": 3, "decay": 0.965}, 0.6, 0.00625),
    "shaped": Choice("shaped_power", {"sigma": 6}, 0.6, 0.0125),
    "pi2": Choice(RIVALS["pi2_bb"], {"population": 10, "decay": 0.9}, 0.3, 0.00625),
    "cma": Choice("cma_es", {"population": 6}, 0.3, 0.00625),
    "random": Choice(RIVALS["random"], {}, 0.3, 0.00625),
}
LEARNERS = {  # what each learns from
    "nothing": "nothing: the demonstration",
    **dict.fromkeys(TUNED, "return"),
    **{f"{name}+model": MODEL for name in TUNED},
    "planner": MODEL,
}


class Model(Protocol):
    """A predictor of returns that may learn from every rollout."""

    def predict(self, z: np.ndarray) -> np.ndarray:
        """Predict the returns of candidates z (B, size). Shape (B,)."""

    def learn(self, z: np.ndarray, ret: float) -> None:
        """Learn from a rollout at z (size,) with return `ret`."""


class InformedLearner:
    """A learner with noisy returns that screens its candidates by a model, if there is one."""

    def __init__(
        self, learner: Learner, model: Model | None, noise: float, rng: np.random.Generator
    ) -> None:
        self.size = learner.size
        self._learner, self._model = learner, model
        self._noise, self._rng = noise, rng
        self._rollouts = 0

    @property
    def mean(self) -> np.ndarray:
        """Mean of the learner. Shape (size,)."""
        return self._learner.mean

    def ask(self) -> np.ndarray:
        """Draw candidates, fewer with every rollout; return the one of highest predicted return."""
        if self._model is None:
            return self._learner.ask()
        count = max(1, round(CANDIDATES * 0.5 ** (self._rollouts / HALF_LIFE)))
        drawn = np.stack([self._learner.ask() for _ in range(count)])
        return drawn[int(np.argmax(self._model.predict(drawn)))] if count > 1 else drawn[0]

    def tell(self, z: np.ndarray, ret: float) -> None:
        """Pass a rollout with its noisy return to learner and model."""
        self._rollouts += 1
        noisy = max(ret + self._noise * float(self._rng.standard_normal()), 0.0)
        self._learner.tell(z, noisy)
        if self._model is not None:
            self._model.learn(z, noisy)


class Planner(RandomSearch):
    """Before every rollout, optimises on the model by CMA-ES from the best rollout so far."""

    def __init__(self, size: int, rng: np.random.Generator, model: Model) -> None:
        super().__init__(size, RandomSearch.Settings(), rng)
        self._model = model

    def ask(self) -> np.ndarray:
        """Return the point of highest predicted return that the search finds. Shape (size,)."""
        search = cmaes.CMA(
            mean=self.mean,
            sigma=STEP,
            population_size=POPULATION,
            seed=int(self._rng.integers(2**32)),
        )
        found, best_return = self.mean, -np.inf
        for _ in range(GENERATIONS):
            drawn = np.stack([search.ask() for _ in range(POPULATION)])
            predicted = self._model.predict(drawn)
            best = int(np.argmax(predicted))
            if predicted[best] > best_return:
                found, best_return = drawn[best], predicted[best]
            search.tell(list(zip(drawn, -predicted, strict=True)))
        return found

    def tell(self, z: np.ndarray, ret: float) -> None:
        """See `Learner.tell`; the model learns too."""
        super().tell(z, ret)
        self._model.learn(z, ret)


def runs(learner: str, noise: float, seeds: list[int], rollouts: int) -> dict[str, Any]:
    """Run a learner of LEARNERS with a standard deviation of the noise, once for each seed.

    Returns:
        Noise-free return of the mean of each run: "early" after 5 rollouts, "final" after the last.
    """
    scenario = synthetic()
    name, _, model = learner.partition("+")
    choice = TUNED.get(name, TUNED["power"])
    noises = scales(choice.stiffness, choice.attractor)
    parameters = parametrization_of(scenario.policy, "full", noises)
    if name == "nothing":
        returns = [scenario.demonstrated_return] * len(seeds)
        return {"early": returns, "final": returns}
    learners = []
    for seed in seeds:
        free_path = ReachModel(parameters, scenario, max(CONTACT_SIGMAS * noise, 1e-9))
        rng = np.random.default_rng([seed, 1])
        if name == "planner":
            made: Learner = Planner(parameters.size, generator(seed), free_path)
        else:
            kind = installed.find("learner", choice.name)
            made = kind(parameters.size, kind.Settings(**choice.settings), generator(seed))
        learners.append(InformedLearner(made, free_path if model else None, noise, rng))
    executed = learn_many(learners, parameters, scenario, rollouts)
    early = min(5, rollouts) - 1
    return {
        "early": [float(run.means[early]) for run in executed],
        "final": [run.final for run in executed],
    }


def line(found: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Mean and standard deviation of the final return, and mean return after 5 rollouts."""
    (runs_,) = found
    final = np.array(runs_["final"])
    values = {"mean": final.mean(), "sd": final.std(ddof=1), "after 5": np.mean(runs_["early"])}
    return {name: round(float(value), 3) for name, value in values.items()}


TABLE = Table(
    NOISES,
    {name: Row(told, {"learner": name}) for name, told in LEARNERS.items()},
    HELD_OUT,
    runs,
    line,
    together=True,
)
