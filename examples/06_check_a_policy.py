# SPDX-License-Identifier: Apache-2.0
"""Simulate a policy on the model of the arm before it is sent: how fast may the movement be?"""

from hardware_sim.wam import JOINTS
from wam_power_ros.bags import reader
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.feasibility import simulate_policy
from wam_power_ros.learning.policy import at_tempo
from wam_power_ros.params.resources import share
from wam_power_ros.tasks.flip.task import Flip

arm = Arm(share("urdf/wam7.urdf").read_text(), JOINTS)
bag = min(share("bags").glob("demo_*"))
demonstration = Flip.demonstration_of(arm, *reader.read_demonstration(bag, JOINTS))
policy = Flip.policy_of([demonstration], "taught")
for tempo in (0.5, 1.0, 1.5):
    found = simulate_policy(arm, ControllerSettings(), at_tempo(policy, tempo))
    print(f"{tempo:.1f} times as fast: {found}")
