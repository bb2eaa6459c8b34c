# SPDX-License-Identifier: Apache-2.0
"""Run a session in this process: reproduce, choose a demonstration, practise, re-test."""

from hardware_sim.scenes import scene_type
from hardware_sim.wam import JOINTS
from hardware_sim.world import World
from wam_power_ros.bags import reader
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.demonstration import from_joint_samples
from wam_power_ros.params.resources import share
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.task import Flip

environment = Environment(World(scene_type("flip"), seed=4))
policies = []
for number, bag in enumerate(sorted(share("bags").glob("demo_*")), start=1):
    taught = from_joint_samples(environment.arm, *reader.read_demonstration(bag, JOINTS))
    policies.append(Flip.policy_of([taught], f"demonstration-{number}"))

settings = preset("flip", budget=8, retests=2)  # every setting: wam_power_ros/tasks/flip
practice = Practice(settings, {}, policies, seed=4, arm=environment)
for record in environment.practise(practice):
    print(f"{record.number:3d} {record.kind:12s} {practice.task.outcome(record)}")
print(f"ended: {practice.stopped}")
