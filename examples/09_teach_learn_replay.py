# SPDX-License-Identifier: Apache-2.0
"""Teach, learn and replay over DDS: the nodes that run on the real arm, here with stand-ins.

With a real arm whose nodes are running, use `robot.connect("geodude")` for `robot.simulated`.
"""

import numpy as np

from wam_power_ros import robot
from wam_power_ros.bags import reader
from wam_power_ros.learning.power import Power
from wam_power_ros.practice.settings import preset

settings = preset("flip", "paper")
task = settings.make_task({})
with robot.simulated("arm", "flip", seed=6) as arm:  # bags and logs go to the folder
    bag = arm.teach()  # on an arm: arm.teach(lambda: input("Guide the arm, then press Enter "))
    print(f"taught {bag.name}")
    taught = task.demonstration_of(arm.arm, *reader.read_demonstration(bag, arm.joint_names))
    parameters = task.parametrization(task.policy_of([taught], "taught"))
    learner = Power(parameters.size, Power.Settings(), np.random.default_rng(6))
    for number in range(4):
        z = parameters.clip(learner.ask()) if number else np.zeros(parameters.size)
        policy, _ = parameters.policy(z, f"trial-{number}")
        found = task.assess(policy, arm.rollout(policy).rollout)
        print(f"{policy.id}: return {found.ret:.3f}" if found.ret is not None else found.why)
        if found.ret is not None:
            learner.tell(z, found.ret)

    print(f"replayed: {arm.replay(bag, speed=0.5)}")
    q = arm.state().q
    q[6] += 0.2  # [rad]
    arm.move_to(q)
    print(f"moved: {arm.state().q.round(2)} rad")
