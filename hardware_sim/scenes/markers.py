# SPDX-License-Identifier: Apache-2.0
"""Scene in which an arm is commissioned: there are markers on its tool, and nothing else."""

from __future__ import annotations

import mujoco
import numpy as np

from hardware_sim.scenes import Scene
from hardware_sim.scenes.flip import HOME
from wam_power_ros import rotations

# Where a person happens to have put the markers on the tool, flat but anyhow turned.
MOUNTED = np.array([0.02, -0.01, 0.01]), rotations.exp(np.array([0.0, 0.0, 0.3]))


class Markers(Scene):
    """Scene of an arm with markers on its tool; the tracked body is the tool's."""

    body = "pancake"
    home = HOME
    mounted = MOUNTED

    def place(
        self, data: mujoco.MjData, position: np.ndarray, rotation: np.ndarray, offset: np.ndarray
    ) -> None:
        """There is nothing to place."""
