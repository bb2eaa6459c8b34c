# SPDX-License-Identifier: Apache-2.0
"""Settings and helpers for the worlds of the tests in this folder."""

from __future__ import annotations

import numpy as np

from hardware_sim.settings import WorldSettings
from hardware_sim.wam import JOINTS
from hardware_sim.world import World
from wam_power_ros.control.arm import Arm
from wam_power_ros.params.resources import share

URDF = share("urdf/wam7.urdf").read_text()
LEVEL = np.deg2rad([0.0, 20.0, 0.0, 115.0, 0.0, -45.0, 0.0])  # [rad] pan level
CALM = WorldSettings(  # no wind, no offset, the same arm in every rollout
    wind_sd=0.0, torque_scale_sd=0.0, friction_sd=0.0, body_offset_sd=0.0
)


def having(**changes: object) -> WorldSettings:
    """`CALM` with some changes."""
    return WorldSettings(**(dict(CALM) | changes))


def holding_torque(world: World, q: np.ndarray = LEVEL) -> np.ndarray:
    """Torque (7,) [N m] that holds the arm in posture q (7,) [rad]."""
    return Arm(world.urdf, JOINTS).gravity(q)


def begin(world: World, rollout_id: str = "trial-0001", q: np.ndarray = LEVEL) -> np.ndarray:
    """Reset and release; returns the gravity torque of the start posture."""
    world.reset(rollout_id, q)
    world.release()
    return holding_torque(world, q)


def run(world: World, tau: np.ndarray | None, ticks: int) -> None:
    """Step the world under a constant torque."""
    for _ in range(ticks):
        world.step(tau)
