# SPDX-License-Identifier: Apache-2.0
"""A world that neither the learner nor the controller's model knows."""

from __future__ import annotations

import zlib
from dataclasses import replace

import numpy as np

from hardware_sim.settings import WorldSettings
from hardware_sim.wam import N


def drawn(settings: WorldSettings, seed: int, rollout_id: str = "") -> WorldSettings:
    """Draw what a laboratory does not know: a world for a whole session, or one for a rollout.

    Mass 70 to 130 % and radius 80 to 120 % of the body's, friction 0.1 to 0.5, delay 2 to 8 ms,
    torque constants 95 to 105 % each, payload at the tool up to 0.12 kg (a fifth of the pan), all
    uniform.

    Args:
        settings: Settings of the world; all others stay.
        seed: Seed of the world.
        rollout_id: Rollout whose world it is; "" for that of the session.
    """
    rng = np.random.default_rng([seed, zlib.crc32(f"unknown world{rollout_id}".encode())])
    scene = replace(
        settings.scene,
        body_mass=float(rng.uniform(0.7, 1.3)),
        body_size=float(rng.uniform(0.8, 1.2)),
        friction=float(rng.uniform(0.1, 0.5)),
    )
    return replace(
        settings,
        scene=scene,
        command_delay_ticks=int(rng.integers(1, 5)),
        torque_constants=tuple(rng.uniform(0.95, 1.05, N).tolist()),
        payload=float(rng.uniform(0.0, 0.12)),
    )
