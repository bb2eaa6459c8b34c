# SPDX-License-Identifier: Apache-2.0
"""Optimise a return of your own on the simulated arm, in this process: the highest swing."""

import numpy as np

from hardware_sim.scenes import scene_type
from hardware_sim.wam import JOINTS
from hardware_sim.world import World
from wam_power_ros.bags import reader
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.cma_es import CmaEs
from wam_power_ros.learning.demonstration import from_joint_samples
from wam_power_ros.learning.parametrization import NoiseScales, parametrization_of
from wam_power_ros.params.resources import share
from wam_power_ros.tasks.flip.task import Flip

environment = Environment(World(scene_type("flip"), seed=1))
bag = min(share("bags").glob("demo_*"))
demonstration = from_joint_samples(environment.arm, *reader.read_demonstration(bag, JOINTS))
taught = Flip.policy_of([demonstration], "taught")
noise = NoiseScales(stiffness=0.1, attractor=0.01, rotation=0.05)
parameters = parametrization_of(taught, "diagonal", noise)
learner = CmaEs(parameters.size, CmaEs.Settings(population=5), np.random.default_rng(1))

for number in range(15):
    z = parameters.clip(learner.ask())
    policy, _ = parameters.policy(z, f"trial-{number}")
    rollout, truth = environment.run(policy)
    height = 0.0 if rollout.fault else float(np.ptp(rollout.tool.position[:, 2]))  # your return
    learner.tell(z, height)
    outcome = rollout.fault.text if rollout.fault else f"the pancake rose by {truth['apex']:.2f} m"
    print(f"{policy.id}: return {height:.3f}, {outcome}")
