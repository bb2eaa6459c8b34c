# SPDX-License-Identifier: Apache-2.0
"""Simulated arms that differ from the controller's model, as real ones do."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np

from hardware_sim.scenes import scene_type
from hardware_sim.settings import WorldSettings
from hardware_sim.wam import N
from hardware_sim.world import World


def _ones() -> np.ndarray:
    return np.ones(N)


def _zeros() -> np.ndarray:
    return np.zeros(N)


@dataclass(frozen=True)
class HiddenArm:
    """Deviations of an arm from its model.

    Attributes:
        payload: Additional mass at the tool; may be negative [kg].
        links: Factor on the mass of each link. Shape (7,).
        friction: Factor on the Coulomb friction of each joint. Shape (7,).
        motors: Factor on the torque of each joint. Shape (7,).
        tilt: Tilt of the base about x and y [rad]. Shape (2,).
        zeros: Reported minus true position of each joint [rad]. Shape (7,).
    """

    payload: float = 0.0
    links: np.ndarray = field(default_factory=_ones)
    friction: np.ndarray = field(default_factory=_ones)
    motors: np.ndarray = field(default_factory=_ones)
    tilt: np.ndarray = field(default_factory=lambda: np.zeros(2))
    zeros: np.ndarray = field(default_factory=_zeros)

    def world(self, delay: int = 2) -> World:
        """World with this arm; its driver holds the last torque, which acts after some periods."""
        settings = WorldSettings(
            watchdog=False,
            command_delay_ticks=delay,
            torque_constants=tuple(self.motors),
            torque_scale_sd=0.0,
            friction_sd=0.0,
        )
        world = World(scene_type("flip"), settings, 0)
        model, pan = world.model, world.model.body("pan").id
        factors = np.ones(model.nbody)
        factors[[model.body(f"wam_link{i}").id for i in range(1, N + 1)]] = self.links
        factors[pan] = 1.0 + self.payload / model.body_mass[pan]
        model.body_mass[:] = model.body_mass * factors
        model.body_inertia[:] = model.body_inertia * factors[:, None]
        world._friction = world._friction * self.friction
        ax, ay = self.tilt
        down = np.array([np.sin(ay), -np.sin(ax) * np.cos(ay), -np.cos(ax) * np.cos(ay)])
        model.opt.gravity[:] = 9.81 * down
        mujoco.mj_setConst(model, world.data)
        return world


KNOWN = {  # single deviations, each far larger than what a laboratory should accept
    "as the model": HiddenArm(),
    "payload of 0.5 kg": HiddenArm(payload=0.5),
    "motor 2 at 70 %": HiddenArm(motors=np.array([1.0, 0.7, 1.0, 1.0, 1.0, 1.0, 1.0])),
    "base tilted 10 degrees": HiddenArm(tilt=np.deg2rad([0.0, 10.0])),
}
PAN_MASS = 0.6  # [kg] of the tool, which a drawn payload is a share of


def draw(seed: int) -> HiddenArm:
    """Draw the deviations of an arm on a laboratory's first day.

    Payload within 20 % of the tool, links within 5 %, friction halved to doubled, torque constants
    within 5 %, zeros of 1 to 3 degrees.
    """
    rng = np.random.default_rng([seed, 0xA12])
    return HiddenArm(
        payload=PAN_MASS * rng.uniform(-0.2, 0.2),
        links=rng.uniform(0.95, 1.05, N),
        friction=2.0 ** rng.uniform(-1.0, 1.0, N),
        motors=rng.uniform(0.95, 1.05, N),
        zeros=np.deg2rad(rng.uniform(1.0, 3.0, N)) * rng.choice([-1.0, 1.0], N),
    )
