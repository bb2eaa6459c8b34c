# SPDX-License-Identifier: Apache-2.0
"""Learn with PoWER to reach past an obstacle, on the equations of the movement alone."""

import numpy as np

from hardware_sim.wam import JOINTS
from wam_power_ros.bags import reader
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.dmp import reproduce_many
from wam_power_ros.learning.parametrization import NoiseScales, parametrization_of
from wam_power_ros.learning.power import Power
from wam_power_ros.params.resources import share
from wam_power_ros.tasks.reach.paths import STEPS, resampled, stopped_paths
from wam_power_ros.tasks.reach.returns import reaching_return
from wam_power_ros.tasks.reach.task import Reach

arm = Arm(share("urdf/wam7.urdf").read_text(), JOINTS)
bags = sorted(share("bags").glob("reach_*"))
shown = [Reach.demonstration_of(arm, *reader.read_demonstration(bag, JOINTS)) for bag in bags]
policy = Reach.policy_of(shown, "demonstration")
start, rest, dt = shown[0].position[0], np.zeros(3), policy.basis.duration / (STEPS - 1)
demonstrated = resampled(shown).mean(axis=0)  # (STEPS, 3) [m]
noise = NoiseScales(stiffness=0.6, attractor=0.00625, rotation=0.1)
parameters = parametrization_of(policy, "full", noise)
learner = Power(parameters.size, Power.Settings(sigma=3, decay=0.965), np.random.default_rng(1))


def return_of(z: np.ndarray) -> float:
    """Return of the paper (Eq. 4) of the policy at the coordinates z."""
    k, mu, _ = parameters.arrays(z[np.newaxis])
    path, _ = reproduce_many(policy.basis, k, mu, policy.damping, start, rest, STEPS, dt)
    stopped, _ = stopped_paths(path, demonstrated[STEPS // 2], 0.09)  # a sphere half way
    return float(reaching_return(stopped, demonstrated, demonstrated[-1])[0])


print(f"demonstrated: {return_of(np.zeros(parameters.size)):.3f}")
for _ in range(100):
    tried = parameters.clip(learner.ask())
    learner.tell(tried, return_of(tried))
print(f"learnt:       {return_of(parameters.clip(learner.mean)):.3f}")
