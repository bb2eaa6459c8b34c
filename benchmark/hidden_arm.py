# SPDX-License-Identifier: Apache-2.0
"""Simulated arms that differ from the controller's model, as real ones do."""

from __future__ import annotations

import numpy as np

from hardware_sim.hidden_arm import HiddenArm
from hardware_sim.scenes import scene_type
from hardware_sim.settings import WorldSettings
from hardware_sim.wam import N
from hardware_sim.world import World

NOMINAL = HiddenArm.of(N)
KNOWN = {  # single deviations, each far larger than what a laboratory should accept
    "as the model": NOMINAL,
    "payload of 0.5 kg": HiddenArm.of(N, payload=0.5),
    "motor 2 at 70 %": HiddenArm.of(N, motors=np.array([1.0, 0.7, 1.0, 1.0, 1.0, 1.0, 1.0])),
    "base tilted 10 degrees": HiddenArm.of(N, tilt=np.deg2rad([0.0, 10.0])),
}
PAN_MASS = 0.6  # [kg] of the tool, which a drawn payload is a share of


def world(hidden: HiddenArm, delay: int = 2) -> World:
    """World with this arm; its driver holds the last torque, which acts after some periods."""
    settings = WorldSettings(
        watchdog=False, command_delay_ticks=delay, torque_scale_sd=0.0, friction_sd=0.0
    )
    return World(scene_type("flip"), settings, hidden=hidden)


def draw(seed: int) -> HiddenArm:
    """Draw the deviations of an arm on a laboratory's first day.

    Payload within 20 % of the tool, links within 5 %, friction halved to doubled, torque constants
    within 5 %, zeros of 1 to 3 degrees.
    """
    rng = np.random.default_rng([seed, 0xA12])
    return HiddenArm.of(
        N,
        payload=PAN_MASS * rng.uniform(-0.2, 0.2),
        links=rng.uniform(0.95, 1.05, N),
        friction=2.0 ** rng.uniform(-1.0, 1.0, N),
        motors=rng.uniform(0.95, 1.05, N),
        zeros=np.deg2rad(rng.uniform(1.0, 3.0, N)) * rng.choice([-1.0, 1.0], N),
    )
