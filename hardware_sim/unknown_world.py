# SPDX-License-Identifier: Apache-2.0
"""Random deviations of the world from the models of controller and learner."""

from __future__ import annotations

import zlib

import numpy as np

from hardware_sim.settings import WorldSettings


def draw(settings: WorldSettings, seed: int, rollout_id: str = "") -> WorldSettings:
    """Draw the properties that are unknown in a laboratory, for a session or for one rollout.

    Uniform: body mass 70 to 130 % and radius 80 to 120 % of nominal, friction 0.1 to 0.5, command
    delay 2 to 8 ms, each torque constant 95 to 105 %, payload at the tool up to 0.12 kg (a fifth of
    the pan).

    Args:
        settings: Settings of the world; the others are kept.
        seed: Seed of the world.
        rollout_id: Id of the rollout; "" for the whole session.
    """
    n = len(settings.model_joint_names)
    rng = np.random.default_rng([seed, zlib.crc32(f"unknown world{rollout_id}".encode())])
    drawn = {
        "body_mass": float(rng.uniform(0.7, 1.3)),
        "body_size": float(rng.uniform(0.8, 1.2)),
        "friction": float(rng.uniform(0.1, 0.5)),
        "command_delay_ticks": int(rng.integers(1, 5)),
        "torque_constants": tuple(rng.uniform(0.95, 1.05, n).tolist()),
        "payload": float(rng.uniform(0.0, 0.12)),
    }
    return settings.model_copy(update=drawn)
