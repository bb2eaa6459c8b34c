# SPDX-License-Identifier: Apache-2.0
"""Fit a movement primitive to a recorded demonstration, and compare what it reproduces with it."""

import numpy as np

from hardware_sim.wam import JOINTS
from wam_power_ros.bags import reader
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.demonstration import from_joint_samples
from wam_power_ros.learning.dmp import fit, reproduce_many
from wam_power_ros.params.resources import share
from wam_power_ros.tasks.flip.settings import FLIP_FIT

bag = min(share("bags").glob("demo_*"))
arm = Arm(share("urdf/wam7.urdf").read_text(), JOINTS)
demonstration = from_joint_samples(arm, *reader.read_demonstration(bag, JOINTS))
policy = fit([demonstration], FLIP_FIT, "fitted")

paths, _ = reproduce_many(
    policy.basis,
    policy.stiffness[np.newaxis],  # many policies at a time, here one
    policy.attractors[np.newaxis],
    policy.damping,
    demonstration.position[0],
    demonstration.velocity[0],
    len(demonstration.t),
    demonstration.period,
)
error = np.linalg.norm(paths[0] - demonstration.position, axis=1)
print(f"{bag.name}: {policy.basis.count} spring-dampers, {policy.basis.duration:.2f} s")
print(f"reproduced within {1000 * error.max():.0f} mm, on average {1000 * error.mean():.1f} mm")
