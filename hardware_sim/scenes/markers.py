# SPDX-License-Identifier: Apache-2.0
"""Scene in which an arm is commissioned: there are markers on its tool, and nothing else."""

from __future__ import annotations

import mujoco
import numpy as np

from hardware_sim.demonstrator import Script
from hardware_sim.ground_truth import RolloutLog, Snapshot, Truth
from hardware_sim.scenes.flip import HOME
from hardware_sim.settings import WorldSettings
from wam_power_ros import rotations

# Where a person happens to have put the markers on the tool, flat but anyhow turned.
MOUNTED = np.array([0.02, -0.01, 0.01]), rotations.exp(np.array([0.0, 0.0, 0.3]))


class Markers:
    """Scene of an arm with markers on its tool, see `Scene`; the tracked body is the tool's."""

    body = "pancake"
    home = HOME
    home_sd = 0.0
    mounted = MOUNTED

    def __init__(self, settings: WorldSettings) -> None:
        """There is nothing to set."""

    def build(self, spec: mujoco.MjSpec, tool: mujoco.MjsBody) -> None:
        """There is nothing to add."""

    def place(
        self, data: mujoco.MjData, position: np.ndarray, rotation: np.ndarray, offset: np.ndarray
    ) -> None:
        """There is nothing to place."""

    def script(self, rng: np.random.Generator) -> Script:
        """Nothing is demonstrated here.

        Raises:
            ValueError: Always.
        """
        raise ValueError("the scene markers has no demonstrations")

    def truth(self, log: RolloutLog, now: Snapshot) -> Truth:
        """A rollout has no outcome here."""
        return {}
