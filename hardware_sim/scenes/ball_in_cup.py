# SPDX-License-Identifier: Apache-2.0
"""Scene of ball-in-a-cup: cup, ball on a string, demonstrated swing, and outcome of a swing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from scipy.interpolate import BSpline

from hardware_sim.contact import WALL, WALLS, add_vessel
from hardware_sim.demonstrator import PAUSE, Target
from hardware_sim.ground_truth import TOOL_SITE, RolloutLog, Snapshot, Truth
from hardware_sim.scenes import Scene
from wam_power_ros.tasks.ball_in_cup.swing import (
    BALL_RADIUS,
    CUP_RADIUS,
    PLANE,
    RIM,
    in_cup,
    landing,
)

BODY = "ball"
MASS = 0.02  # [kg] of the ball
HOME = np.deg2rad([0.0, 0.0, 0.0, 110.0, 0.0, -20.0, 0.0])  # [rad] cup upright
HOME.setflags(write=False)
KNOT = 0.2  # [s] between two points of the swing
# Outward and up, relative to the cup's start [m]: found by optimisation, first of a planar model of
# a point on a string, then of this scene with its demonstrator. The ball swings up on the far side;
# its landing does not change, in first order, with the size of the movement.
SWING = np.array(
    [
        (0.1309, 0.0850),
        (0.0988, 0.0193),
        (-0.0562, -0.0006),
        (-0.1852, 0.0837),
        (-0.1004, 0.1302),
        (-0.0722, -0.0570),
        (0.1470, -0.0770),
        (0.1829, 0.0281),
        (-0.0565, -0.0333),
    ]
)
SWING.setflags(write=False)


class BallInCup(Scene):
    """Scene of ball-in-a-cup, see `Scene`. String and forearm do not touch."""

    body = BODY
    home = HOME

    def build(self, spec: mujoco.MjSpec, tool: mujoco.MjsBody) -> None:
        """Add the cup, and the ball on its string."""
        radius = CUP_RADIUS + WALL
        contact = self.contact | {"rgba": [0.75, 0.75, 0.78, 0.5]}
        add_vessel(tool, "cup", radius, RIM, radius * np.tan(np.pi / WALLS), **contact)
        ball = self.add_body(
            spec,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[BALL_RADIUS * self.settings.body_size, 0.0, 0.0],
            mass=MASS * self.settings.body_mass,
            rgba=[0.86, 0.35, 0.12, 1.0],
        )
        ball.add_site(name=BODY, group=4)
        string = spec.add_tendon(
            name="string",
            limited=True,
            range=[0.0, self.settings.string],
            solref_limit=[0.004, 1.0],  # stiff, without a rebound
            width=0.001,
            rgba=[0.3, 0.3, 0.3, 1.0],
        )
        string.wrap_site(TOOL_SITE)
        string.wrap_site(BODY)

    def place(
        self, data: mujoco.MjData, position: np.ndarray, rotation: np.ndarray, offset: np.ndarray
    ) -> None:
        """Let the ball hang below the cup."""
        data.joint(BODY).qpos[:] = [*position, 1.0, 0.0, 0.0, 0.0]
        data.joint(BODY).qpos[2] -= self.settings.string

    def script(self, rng: np.random.Generator) -> SwingScript:
        """Draw a random swing."""
        return swing(rng, self.settings.spread)

    heading = Scene.outward

    def truth(self, log: RolloutLog, now: Snapshot) -> Truth:
        """Outcome of a swing.

        * caught: The ball is now in the cup.
        * apex: Highest point of the ball above `PLANE` of an upright cup [m].
        * t_c: Time at which it came down through this plane [s], see `landing`; None if never.
        * distance: Its horizontal distance from the middle of the cup then [m]; None without t_c.
        """
        relative = log.body[:, :3] - log.tool - [0.0, 0.0, PLANE]
        t_c = distance = None
        if (k := landing(relative)) is not None:
            t_c, distance = (k + 1) * log.period, float(np.hypot(*relative[k, :2]))
        return {
            "caught": in_cup(now.rotation.T @ (now.body[:3] - now.position)),
            "apex": float(relative[:, 2].max(initial=-self.settings.string - PLANE)),
            "t_c": t_c,
            "distance": distance,
        }


@dataclass(frozen=True)
class SwingScript:
    """Planar swing: a cubic B-spline of the cup's position, which stays upright."""

    # Control points outward and up, relative to the initial position [m], (n, 2); the first three
    # and the last three are equal, so it goes from rest to rest
    points: np.ndarray
    knot: float  # time from one point to the next [s]

    @property
    def end(self) -> float:
        """See `Script`."""
        return PAUSE + self.knot * (len(self.points) - 3)

    def target(self, t: float, position: np.ndarray, rotation: np.ndarray) -> Target:
        """See `Script`."""
        at = min(max(t - PAUSE, 0.0), self.end - PAUSE)
        (x, z), (vx, vz) = self._path(at), self._speed(at)
        velocity = np.array([vx, 0.0, vz])
        return Target(position + np.array([x, 0.0, z]), rotation, velocity, np.zeros(3))

    @cached_property
    def _path(self) -> BSpline:
        knots = self.knot * np.arange(-3.0, len(self.points) + 1.0)
        return BSpline(knots, self.points, 3)

    @cached_property
    def _speed(self) -> BSpline:
        return self._path.derivative()


def swing(rng: np.random.Generator, spread: float = 1.0) -> SwingScript:
    """Draw a swing of 2.2 s: to and fro in time with the ball, then up.

    `spread` scales the differences between swings: 0 for the intended one, 1 for a practised
    person's.
    """
    size = 1.0 + spread * 0.015 * float(rng.standard_normal())
    knot = KNOT * (1.0 + spread * 0.01 * float(rng.standard_normal()))
    own = size * SWING + spread * 0.003 * rng.standard_normal(SWING.shape)
    still = np.zeros((3, 2))
    return SwingScript(np.vstack([still, own, own[-1:], own[-1:]]), knot)
