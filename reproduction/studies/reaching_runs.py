# SPDX-License-Identifier: Apache-2.0
"""A synthetic scenario of reaching, and runs of learners on any scenario, in batches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from reproduction.studies.reaching_scenario import RADIUS, Scenario
from wam_power_ros.learning.demonstration import from_positions
from wam_power_ros.learning.dmp import fit
from wam_power_ros.learning.learner import Learner
from wam_power_ros.learning.parametrization import NoiseScales, Parametrization, parametrization_of
from wam_power_ros.learning.power import Power
from wam_power_ros.tasks.reach.paths import STEPS
from wam_power_ros.tasks.reach.settings import REACH_FIT


def scales(stiffness: float, attractor: float) -> NoiseScales:
    """Exploration scales of a reach, which does not learn the rotation."""
    return NoiseScales(stiffness=stiffness, attractor=attractor, rotation=0.1)


VARIANTS = ("full", "diagonal")
# Near the optimum for each variant on 60 tuning seeds: full .765, and within .003 of it at twice
# either scale; diagonal .598.
NOISE = {"full": scales(0.6, 0.00625), "diagonal": scales(0.6, 0.1)}
POWER = Power.Settings(sigma=3, decay=0.965)  # as in the authors' scripts
CHUNK = 10  # runs of a job, evaluated together: another number changes last digits
PATH_SAMPLES = 50  # samples of a path kept for a figure
# Of the synthetic demonstrations:
DURATION = 2.0  # of a demonstration [s]
START, GOAL = np.array([0.4, -0.25, 0.3]), np.array([0.4, 0.25, 0.3])  # mean ends [m]
ARC = 0.06  # height of the mean demonstration above the straight line, half way [m]
SCATTER = 0.01  # standard deviation of a demonstration's ends and arc [m]
COUNT = 4  # demonstrations


def synthetic() -> Scenario:
    """Demonstrations of a reach past an obstacle, in place of the paper's, which it omits.

    They are minimum-jerk movements along a line with an arc in z, half a metre in 2 s. The scatter
    is shifted to mean zero: the mean demonstration has exactly the given ends and arc.
    """
    s = np.linspace(0.0, 1.0, STEPS)
    s = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    offset = SCATTER * np.random.Generator(np.random.PCG64(0)).standard_normal((COUNT, 7))
    offset -= offset.mean(axis=0)
    first = START + offset[:, None, :3]  # (COUNT, 1, 3)
    last = GOAL + offset[:, None, 3:6]
    paths = first + s[:, None] * (last - first)
    paths[..., 2] += (ARC + offset[:, 6:]) * np.sin(np.pi * s)
    period = DURATION / (STEPS - 1)
    policy = fit([from_positions(path, period) for path in paths], REACH_FIT, "demonstration")
    return Scenario(paths, policy, START)


@dataclass(frozen=True, eq=False)
class Run:
    """One run of a learner.

    Attributes:
        returns: Returns of its rollouts, in order. Shape (rollouts,).
        means: Return of the mean, without exploration, after each of them. Shape (rollouts,).
        stuck: Whether the last mean still meets the obstacle.
        mean: Coordinates of the last mean, clipped. Shape (size,).
    """

    returns: np.ndarray
    means: np.ndarray
    stuck: bool
    mean: np.ndarray

    @property
    def best(self) -> float:
        """Highest return of a rollout."""
        return float(self.returns.max())

    @property
    def final(self) -> float:
        """Return of the mean after the last rollout."""
        return float(self.means[-1])


def learn_many(
    learners: Sequence[Learner], parameters: Parametrization, scenario: Scenario, rollouts: int
) -> list[Run]:
    """Run independent learners; each learns from the clipped policies, of positive stiffness."""
    returns, means = np.empty((2, rollouts, len(learners)))
    for k in range(rollouts):
        drawn = np.stack([parameters.clip(learner.ask()) for learner in learners])
        returns[k], _ = evaluate(drawn, parameters, scenario)
        for learner, z, ret in zip(learners, drawn, returns[k], strict=True):
            learner.tell(z, float(ret))
        mean = np.stack([parameters.clip(learner.mean) for learner in learners])
        means[k], stuck = evaluate(mean, parameters, scenario)
    return [
        Run(returns[:, k].copy(), means[:, k].copy(), bool(stuck[k]), mean[k])
        for k in range(len(learners))
    ]


def study(variant: str, seeds: Sequence[int], rollouts: int, scenario: Scenario) -> list[Run]:
    """Run PoWER on one variant for every seed."""
    parameters = parametrization_of(scenario.policy, variant, NOISE[variant])
    learners = [Power(parameters.size, POWER, generator(seed)) for seed in seeds]
    return learn_many(learners, parameters, scenario, rollouts)


def generator(seed: int) -> np.random.Generator:
    """Random generator of a run."""
    return np.random.Generator(np.random.PCG64(seed))


def as_data(
    runs: Sequence[Run], seeds: Sequence[int], variant: str, scenario: Scenario
) -> dict[str, Any]:
    """Runs of one variant as JSON data, with the paths of their last means."""
    parameters = parametrization_of(scenario.policy, variant, NOISE[variant])
    stiffness, attractors, _ = parameters.arrays(np.stack([run.mean for run in runs]))
    path, _ = scenario.stopped_paths(scenario.free_paths(stiffness, attractors))
    shown = np.linspace(0, STEPS - 1, PATH_SAMPLES).round().astype(int)
    return {
        "variant": variant,
        "seeds": list(seeds),
        "start": demonstrated_return(scenario),
        "best": [run.best for run in runs],
        "stuck": [run.stuck for run in runs],
        "means": np.stack([run.means for run in runs]).round(6).tolist(),
        "paths": path[:, shown].round(5).tolist(),
        "demonstrations": scenario.demonstrations[:, shown].round(5).tolist(),
        "obstacle": scenario.obstacle.round(5).tolist(),
        "radius": RADIUS,
    }


def demonstrated_return(scenario: Scenario) -> float:
    """Return (Eq. 4) of the policy fitted to the demonstrations."""
    policy = scenario.policy
    returns, _ = scenario.evaluate(policy.stiffness[np.newaxis], policy.attractors[np.newaxis])
    return float(returns[0])


def evaluate(
    z: np.ndarray, parameters: Parametrization, scenario: Scenario
) -> tuple[np.ndarray, np.ndarray]:
    """Returns (Eq. 4) of policies at z (B, size), and whether each collided. Shapes (B,)."""
    stiffness, attractors, _ = parameters.arrays(z)
    return scenario.evaluate(stiffness, attractors)
