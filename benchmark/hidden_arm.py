# SPDX-License-Identifier: Apache-2.0
"""Simulated arms that differ from the controller's model, as real ones do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmark.false_states import PERIOD
from benchmark.loop import MOMENTS, Loop
from benchmark.nodes import JOINTS, taught
from hardware_sim.demonstrator import Demonstrator
from hardware_sim.hidden_arm import HiddenArm
from hardware_sim.scenes import scene_type
from hardware_sim.scenes.flip import wrist_flick
from hardware_sim.settings import WorldSettings
from hardware_sim.world import World
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError
from wam_power_ros.control.safety import limits_of

NOMINAL = HiddenArm()
KNOWN = {  # single deviations, each far larger than what a laboratory should accept
    "as the model": NOMINAL,
    "payload of 0.5 kg": HiddenArm(payload=0.5),
    "motor 2 at 70 %": HiddenArm(motors=np.array([1.0, 0.7, 1.0, 1.0, 1.0, 1.0, 1.0])),
    "base tilted 10 degrees": HiddenArm(tilt=np.deg2rad([0.0, 10.0])),
}


class StandIn:
    """Arm of the stand-in at the start of the taught policy; its driver holds the last torque."""

    def __init__(self, hidden: HiddenArm = NOMINAL) -> None:
        settings = WorldSettings(
            watchdog=False, command_delay_ticks=2, torque_scale_sd=0.0, friction_sd=0.0
        )
        self.world, self._zeros = World(scene_type("flip"), settings, hidden=hidden), hidden.zeros
        self._arm = Arm(self.world.urdf, JOINTS)
        self.world.reset("moments", taught().q_start)
        self.world.release()

    def step(self, tau: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """See `Plant`."""
        self.world.step(tau)
        sample = self.world.joint_state()
        return sample.q, sample.qd

    def tool_position(self) -> np.ndarray:
        """See `Plant`."""
        return self.world.tool_pose[0]

    def tool_speed(self) -> float:
        """See `Plant`."""
        sample = self.world.joint_state()
        return self._arm.speeds(sample.q - self._zeros, sample.qd).tool_speed

    def gravity(self) -> np.ndarray:
        """g(q) at the present posture [N m]. Shape (7,)."""
        return self._arm.gravity(self.world.joint_state().q)

    def guide(self, seed: int) -> None:
        """Attach a demonstrator with this seed to the pan."""
        flick = wrist_flick(np.random.default_rng(seed))
        self.world.attach(Demonstrator(flick, *self.world.tool_pose))

    def let_go(self) -> None:
        """See `Plant`."""
        self.world.attach(None)


def taught_fast(arm: Arm) -> Controller:
    """Controller of an arm that is guided at the speed of a toss."""
    return Controller(arm, ControllerSettings(limits=limits_of(arm, teaching_tool_speed=4.0)))


def held(hidden: HiddenArm = NOMINAL, make: Callable[[Arm], Controller] = taught_fast) -> Loop:
    """An arm of the stand-in that is held at the start of the policy."""
    plant = StandIn(hidden)
    loop = Loop(plant, make(Arm(plant.world.urdf, JOINTS)))
    loop.hold(0.3)
    return loop


def begin(loop: Loop, phase: str) -> str:
    """Bring a held arm to a phase; returns why it was not reached, empty if it was."""
    try:
        _begin(loop, phase)
    except ControllerError as error:
        return str(error)
    return "" if loop.controller.latched is None else loop.controller.latched.text


def _begin(loop: Loop, phase: str) -> None:
    core, plant = loop.controller, loop.plant
    loop.play(0.5)
    if phase in MOMENTS:
        core.move_to_start()
        for _ in range(2000):
            loop.play(PERIOD)
            if core.ready:
                break
        core.execute()
        loop.play(MOMENTS[phase] * loop.policy.basis.duration)
    elif phase in ("move", "teaching"):
        core.set_gravity_compensation(True)
        plant.guide(0)
        loop.play(0.4)
    if phase == "move":
        plant.let_go()
        core.set_gravity_compensation(False)
        loop.play(1.0)
        core.move_to_start()
        loop.play(0.3)
