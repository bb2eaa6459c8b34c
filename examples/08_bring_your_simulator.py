# SPDX-License-Identifier: Apache-2.0
"""Run the torque controller on a simulation of your own: one torque for each joint state."""

import numpy as np

from hardware_sim.wam import JOINTS
from wam_power_ros.bags import reader
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import Mode
from wam_power_ros.params.resources import share
from wam_power_ros.tasks.reach.task import Reach

arm = Arm(share("urdf/wam7.urdf").read_text(), JOINTS)
bag = min(share("bags").glob("reach_*"))
demonstration = Reach.demonstration_of(arm, *reader.read_demonstration(bag, JOINTS))
policy = Reach.policy_of([demonstration], "taught")

controller = Controller(arm, settings := ControllerSettings())
q, qd, dt = policy.q_start.copy(), np.zeros(arm.n), settings.period


def tick(number: int) -> None:
    """Your simulator: here the rigid-body model, with its friction, for one period."""
    global q, qd
    tau = controller.step(round(number * dt * 1e9), q, qd)
    resistance = arm.friction / np.maximum(np.abs(qd), 0.01) + arm.damping
    qd = qd + dt * arm.resisted_dynamics(q, qd, tau, resistance, dt)
    q = q + dt * qd


tick(1)
controller.hold()
controller.load(policy)
controller.move_to_start()
ticks = iter(range(2, 10_000))
while not controller.ready:
    tick(next(ticks))
controller.execute()
while controller.mode is Mode.ROLLOUT:
    tick(next(ticks))
path = controller.take_finished()
print(f"{len(path.t)} positions in {path.t[-1]:.1f} s, {controller.latched or 'no fault'}")
print(f"from {path.position[0].round(2)} m to {path.position[-1].round(2)} m")
