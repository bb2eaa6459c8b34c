# SPDX-License-Identifier: Apache-2.0
"""Scene of reaching past an obstacle: sphere, demonstrated reach, and clearance of a reach.

The sphere is visual only: a touch is the centre of the tool within 1 mm of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from hardware_sim.demonstrator import PAUSE, Target
from hardware_sim.ground_truth import RolloutLog, Snapshot, Truth
from hardware_sim.scenes import Scene
from hardware_sim.settings import REACH_GOAL

TOUCH_TOLERANCE = 0.001  # [m]; the controller stops at the obstacle by its encoders


class Reach(Scene):
    """Scene of reaching, see `Scene`: nothing is tracked."""

    home_sd = 0.008

    has_goal = True

    def build(self, spec: mujoco.MjSpec, tool: mujoco.MjsBody) -> None:
        """Draw the obstacle."""
        if (region := self.settings.region) is not None:
            spec.worldbody.add_geom(
                name="obstacle",
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[region.radius, 0.0, 0.0],
                pos=region.centre,
                rgba=[0.8, 0.2, 0.15, 0.6],
                contype=0,
                conaffinity=0,
            )

    def script(self, rng: np.random.Generator) -> ReachScript:
        """Draw a random reach."""
        return reach(rng, self.settings.goal, self.settings.spread)

    def truth(self, log: RolloutLog, now: Snapshot) -> Truth:
        """Outcome of a reach.

        * touched: The tool's centre was within `TOUCH_TOLERANCE` of the obstacle, or inside.
        * clearance: Smallest distance of the tool's centre from the obstacle's surface [m],
          negative inside; None without an obstacle.
        * goal_distance: Smallest distance of the tool's centre from the goal [m].
        """
        path = np.vstack([log.start.position, log.tool])
        clearance = None
        if (region := self.settings.region) is not None:
            nearest = np.linalg.norm(path - region.centre, axis=1).min()
            clearance = float(nearest - region.radius)
        return {
            "touched": clearance is not None and clearance < TOUCH_TOLERANCE,
            "clearance": clearance,
            "goal_distance": float(np.linalg.norm(path - self.settings.goal, axis=1).min()),
        }


@dataclass(frozen=True)
class ReachScript:
    """Reach to a goal in an arc with constant orientation: minimum jerk with warped time."""

    goal: np.ndarray  # final position [m], (3,)
    arc: np.ndarray  # offset of the middle of the path from the straight line [m], (3,)
    duration: float  # of the movement [s]
    warp: float  # in (-1, 1); positive if the first half of the path is faster

    @property
    def end(self) -> float:
        """See `Script`."""
        return PAUSE + self.duration

    def target(self, t: float, position: np.ndarray, rotation: np.ndarray) -> Target:
        """See `Script`."""
        u = min(max(t - PAUSE, 0.0) / self.duration, 1.0)
        s, rate = u + self.warp * u * (1.0 - u), 1.0 + self.warp * (1.0 - 2.0 * u)
        rate *= 30.0 * s**2 * (1.0 - s) ** 2 / self.duration
        s = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        way, angle = self.goal - position, np.pi * s
        return Target(
            position + s * way + np.sin(angle) * self.arc,
            rotation,
            rate * (way + np.pi * np.cos(angle) * self.arc),
            np.zeros(3),
        )


def reach(
    rng: np.random.Generator, goal: ArrayLike = REACH_GOAL, spread: float = 1.0
) -> ReachScript:
    """Draw a reach in 2 s with an arc of 6 cm, such as half a metre from `HOME` to `REACH_GOAL`.

    `goal` (3,) [m] is the intended end, `spread` the scale of the differences between reaches: 0
    for the intended one, 1 for a person's.
    """
    goal = goal + spread * 0.01 * rng.standard_normal(3)
    arc = np.array([0.0, 0.0, 0.06]) + spread * 0.01 * rng.standard_normal(3)
    duration = 2.0 * (1.0 + spread * 0.05 * float(rng.standard_normal()))
    warp = spread * float(np.clip(0.1 * rng.standard_normal(), -0.3, 0.3))
    return ReachScript(goal, arc, duration, warp)
