# SPDX-License-Identifier: Apache-2.0
"""Learn with PoWER to reach past an obstacle, on the equations of the movement alone."""

import numpy as np

from hardware_sim.wam import JOINTS
from wam_power_ros.bags import reader
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.demonstration import from_joint_samples
from wam_power_ros.learning.parametrization import NoiseScales, parametrization_of
from wam_power_ros.learning.power import Power
from wam_power_ros.params.resources import share
from wam_power_ros.tasks.reach.scenario import scenario_of

arm = Arm(share("urdf/wam7.urdf").read_text(), JOINTS)
bags = sorted(share("bags").glob("reach_*"))
scenario = scenario_of(
    [from_joint_samples(arm, *reader.read_demonstration(bag, JOINTS)) for bag in bags]
)
noise = NoiseScales(stiffness=0.6, attractor=0.00625, rotation=0.1)
parameters = parametrization_of(scenario.policy, "full", noise)
learner = Power(parameters.size, Power.Settings(sigma=3, decay=0.965), np.random.default_rng(1))


def return_of(z: np.ndarray) -> float:
    """Return of the paper (Eq. 4) of the policy at the coordinates z."""
    stiffness, attractors, _ = parameters.arrays(z[np.newaxis])
    returns, _ = scenario.evaluate(stiffness, attractors)
    return float(returns[0])


print(f"demonstrated: {return_of(np.zeros(parameters.size)):.3f}")
for _ in range(100):
    tried = parameters.clip(learner.ask())
    learner.tell(tried, return_of(tried))
print(f"learnt:       {return_of(parameters.clip(learner.mean)):.3f}")
