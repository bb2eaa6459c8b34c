# SPDX-License-Identifier: Apache-2.0
"""Reaching past an obstacle, the paper's simulated experiment (Sec. III-A): runs of learners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from reproduction.jobs import Job, Scale
from reproduction.studies.reaching_scenario import Scenario, synthetic
from wam_power_ros.learning.learner import Learner
from wam_power_ros.learning.parametrization import NoiseScales, Parametrization, parametrization_of
from wam_power_ros.learning.power import Power
from wam_power_ros.tasks.reach.paths import STEPS

SYNTHETIC = "reaching-synthetic"  # study
TUNING = range(1_000_000, 1_000_060)
HELD_OUT = range(401, 441)  # seeds not used for tuning


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


@dataclass(frozen=True, eq=False)
class Run:
    """One run of a learner."""

    returns: np.ndarray  # of its rollouts, in order, shape (rollouts,)
    means: np.ndarray  # return of the mean, without exploration, after each, shape (rollouts,)
    stuck: bool  # whether the last mean still meets the obstacle
    mean: np.ndarray  # coordinates of the last mean, clipped, shape (size,)

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


def study(variant: str, seeds: Sequence[int], rollouts: int) -> list[Run]:
    """Run PoWER on one variant for every seed."""
    scenario = synthetic()
    parameters = parametrization_of(scenario.policy, variant, NOISE[variant])
    learners = [Power(parameters.size, POWER, generator(seed)) for seed in seeds]
    return learn_many(learners, parameters, scenario, rollouts)


def generator(seed: int) -> np.random.Generator:
    """Random generator of a run."""
    return np.random.Generator(np.random.PCG64(seed))


def runs(variant: str, seeds: Sequence[int], rollouts: int) -> dict[str, Any]:
    """Runs of one variant as JSON data, with the paths of their last means."""
    scenario, found = synthetic(), study(variant, seeds, rollouts)
    parameters = parametrization_of(scenario.policy, variant, NOISE[variant])
    stiffness, attractors, _ = parameters.arrays(np.stack([run.mean for run in found]))
    path, _ = scenario.stopped_paths(scenario.free_paths(stiffness, attractors))
    shown = np.linspace(0, STEPS - 1, PATH_SAMPLES).round().astype(int)
    return {
        "variant": variant,
        "best": [float(run.returns.max()) for run in found],
        "stuck": [run.stuck for run in found],
        "means": np.stack([run.means for run in found]).round(6).tolist(),
        "paths": path[:, shown].round(5).tolist(),
    }


def evaluate(
    z: np.ndarray, parameters: Parametrization, scenario: Scenario
) -> tuple[np.ndarray, np.ndarray]:
    """Returns (Eq. 4) of policies at z (B, size), and whether each collided. Shapes (B,)."""
    stiffness, attractors, _ = parameters.arrays(z)
    return scenario.evaluate(stiffness, attractors)


def jobs(scale: Scale) -> list[Job]:
    """Runs of the chapter on held-out seeds; in "quick", few rollouts on two tuning seeds."""
    full = scale == "full"
    seeds: Sequence[int] = HELD_OUT if full else TUNING[:2]
    rollouts = 100 if full else 10
    found = []
    for variant in VARIANTS:
        for k in range(0, len(seeds), CHUNK):
            chunk = list(seeds[k : k + CHUNK])
            one = {"variant": variant, "seeds": chunk, "rollouts": rollouts}
            found.append(Job(SYNTHETIC, f"{variant}-{chunk[0]}-{chunk[-1]}", runs, one))
    return found
