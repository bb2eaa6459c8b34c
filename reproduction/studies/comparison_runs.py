# SPDX-License-Identifier: Apache-2.0
"""One learner on one task for the comparison: reaching (Eq. 4) on Eq. 1, pancake (Eq. 5) in MuJoCo.

Every learner has the same number of rollouts and the same return function. Settings are passed as
data, so that a result depends on its arguments only and not on the table of tuned settings.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hardware_sim.scenes import scene_type
from hardware_sim.world import World
from reproduction.rivals.learners import RIVALS, Model, ScreenedPower
from reproduction.rivals.reach_model import ReachModel
from reproduction.rivals.toss_model import TossModel
from reproduction.studies.flip_sessions import NOVICE, teach
from reproduction.studies.reaching_runs import generator, learn_many, scales, synthetic
from wam_power_ros import installed
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.learner import Learner
from wam_power_ros.learning.parametrization import parametrization_of
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.assessment import assess
from wam_power_ros.tasks.flip.parametrization import flip_parametrization

VARIANT = "full"  # on both tasks
REPEATS = 3  # rollouts of the final mean


def reaching_runs(
    settings: dict[str, Any], stiffness: float, attractor: float, seeds: list[int], rollouts: int
) -> dict[str, Any]:
    """Run a learner on the synthetic reach; arguments as in `comparison.Choice`.

    Returns:
        Per seed: "final" return of the mean, "returns" of the rollouts, "means": those of the mean
        after each rollout.
    """
    scenario = synthetic()
    parameters = parametrization_of(scenario.policy, VARIANT, scales(stiffness, attractor))
    size, model = parameters.size, lambda: ReachModel(parameters, scenario)
    learners = [learner_of(settings, size, seed, model()) for seed in seeds]
    runs = learn_many(learners, parameters, scenario, rollouts)
    return {
        "seeds": seeds,
        "final": [run.final for run in runs],
        "returns": np.stack([run.returns for run in runs]).round(6).tolist(),
        "means": np.stack([run.means for run in runs]).round(6).tolist(),
    }


def pancake_run(
    settings: dict[str, Any], stiffness: float, attractor: float, seed: int, rollouts: int
) -> dict[str, Any]:
    """Run a learner on a toss with one demonstration, Eq. 5 and noisy rollouts.

    The first rollout reproduces the demonstration. A rollout that ends in a fault, or in which the
    pancake is lost from view, returns 0. Arguments are as in `comparison.Choice`.

    Returns:
        "returns" of the rollouts, "repeats" of the final mean, number of "faults" of the rollouts.
    """
    environment = Environment(World(scene_type("flip"), seed=seed))
    (demonstrated,) = teach(environment, seed, 1, pitch_rate=NOVICE)
    noise = {"stiffness": stiffness, "attractor": attractor}
    paper = preset("flip", "paper", variant=VARIANT, noise=noise).task_settings
    parameters = flip_parametrization(demonstrated, VARIANT, paper.noise)
    start, _ = environment.arm.tool_pose(demonstrated.q_start)
    model = TossModel(parameters, start)
    learner = learner_of(settings, parameters.size, seed, model)

    def returned(z: np.ndarray, policy_id: str) -> tuple[float, bool]:
        policy, _ = parameters.policy(z, policy_id)
        rollout, _ = environment.run(policy)
        ret = assess(policy, rollout, paper).ret
        return ret or 0.0, rollout.fault is not None

    returns, faults = [], 0
    for k in range(rollouts):
        z = np.zeros(parameters.size) if k == 0 else parameters.clip(learner.ask())
        ret, fault = returned(z, f"trial-{k}")
        learner.tell(z, ret)
        returns.append(ret)
        faults += fault
    mean = parameters.clip(learner.mean)
    repeats = [returned(mean, f"repeat-{k}")[0] for k in range(REPEATS)]
    return {"seed": seed, "returns": returns, "repeats": repeats, "faults": faults}


def learner_of(settings: dict[str, Any], size: int, seed: int, model: Model) -> Learner:
    """Construct the learner named by "kind" in `settings` ("power" if omitted).

    Raises:
        ValueError: The learner or a setting is unknown, or a value is out of range.
    """
    values = dict(settings)
    kind = values.pop("kind", "power")
    found = installed.find("learner", RIVALS.get(kind, kind))
    given = [model] if found is ScreenedPower else []
    learner: Learner = found(size, found.Settings(**values), generator(seed), *given)
    return learner
