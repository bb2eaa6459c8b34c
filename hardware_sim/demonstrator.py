# SPDX-License-Identifier: Apache-2.0
"""The demonstrating hand: pulls the pan along a movement of its own making, as a person would.

The hand is a spring-damper between the pan and a wanted pose; the arm only carries its weight. No
two demonstrations are alike: timing, reach and flick are drawn anew, and most tosses miss.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from hardware_sim.world import HOME
from wam_power_ros import rotations

STIFFNESS = 3000.0  # [N/m]
DAMPING = 120.0  # [N s/m]
ROTATION_STIFFNESS = 60.0  # [N m/rad]
ROTATION_DAMPING = 3.0  # [N m s/rad]
FORCE_MAX = 150.0  # [N] what a person's arm gives
MOMENT_MAX = 15.0  # [N m]
PITCH_RATE = 7.6  # [rad/s] of a practised hand: most of its tosses reproduce at 90 degrees or more
REACH = 0.34  # [m] from the wrist to the pan's centre
REACH_HOME = np.deg2rad([-29.5, 27.2, 0.0, 116.3, -35.3, -58.9, 20.1])  # [rad] the pan level, right
REACH_HOME.setflags(write=False)
REACH_GOAL = np.array([0.78, 0.25, 0.6])  # [m] half a metre to the left of where the pan is there
REACH_GOAL.setflags(write=False)
PAUSE = 0.25  # [s] at rest before a movement


class Target(NamedTuple):
    """Where the hand wants the pan, and how fast."""

    position: np.ndarray  # (3,) [m]
    rotation: np.ndarray  # (3, 3)
    velocity: np.ndarray  # (3,) [m/s]
    omega: np.ndarray  # (3,) [rad/s]


class Script(Protocol):
    """A movement, before it is known where it begins."""

    @property
    def end(self) -> float:
        """When it is over [s]."""
        ...

    def target(self, t: float, position: np.ndarray, rotation: np.ndarray) -> Target:
        """At time t [s], when the hand took the pan at `position` (3,), `rotation` (3, 3)."""
        ...


@dataclass(frozen=True)
class HandScript:
    """A planar toss: keys of the wrist and of the pan's pitch, relative to where it begins.

    Attributes:
        t: times of the keys, the first at 0 [s]. Shape (n,)
        wrist: x outward and z up [m]. Shape (n, 2)
        wrist_speed: [m/s]. Shape (n, 2)
        pitch: of the front edge upward [rad]. Shape (n,)
        pitch_rate: [rad/s]. Shape (n,)
    """

    t: np.ndarray
    wrist: np.ndarray
    wrist_speed: np.ndarray
    pitch: np.ndarray
    pitch_rate: np.ndarray

    @property
    def end(self) -> float:
        """See `Script`."""
        return float(self.t[-1])

    def target(self, t: float, position: np.ndarray, rotation: np.ndarray) -> Target:
        """See `Script`."""
        at = min(t, self.end)
        x, z = self._wrist(at)
        vx, vz = self._wrist(at, 1) if t < self.end else (0.0, 0.0)
        rate = float(self._pitch(at, 1)) if t < self.end else 0.0
        # the front edge rises when the pan turns about -y
        turn = rotations.exp(np.array([0.0, -float(self._pitch(at)), 0.0]))
        wrist = position - REACH * rotation[:, 0]
        rotation = turn @ rotation
        lever = REACH * rotation[:, 0]
        omega = np.array([0.0, -rate, 0.0])
        velocity = np.array([vx, 0.0, vz]) + np.cross(omega, lever)
        return Target(wrist + np.array([x, 0.0, z]) + lever, rotation, velocity, omega)

    @cached_property
    def _wrist(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.t, self.wrist, self.wrist_speed)

    @cached_property
    def _pitch(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.t, self.pitch, self.pitch_rate)


@dataclass(frozen=True)
class ReachScript:
    """A reach to a place in an arc, the pan kept as it was taken: minimum jerk, a little warped.

    Attributes:
        goal: Where it ends [m]. Shape (3,)
        arc: How far half of the way is from the straight line [m]. Shape (3,)
        duration: [s]
        warp: In (-1, 1); positive when the first half of the way is the faster one.
    """

    goal: np.ndarray
    arc: np.ndarray
    duration: float
    warp: float

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


def wrist_flick(
    rng: np.random.Generator, spread: float = 1.0, pitch_rate: float = PITCH_RATE
) -> HandScript:
    """A toss from the wrist: flick the front edge up, follow under the pancake, cushion its fall.

    It begins at the world's `HOME`, the pan tilted forward and the pancake slid against the front
    of the rim, as a cook does: from there a flick throws it the same way every time. Out of a level
    pan, the pancake would slide or not slide to the rim on the way, and throws scatter by 15 cm.

    Args:
        rng: what makes this demonstration differ from the next.
        spread: 0 for the hand's intention, 1 for a person's scatter about it.
        pitch_rate: intended at the release [rad/s].
    """

    def scatter(sd: float, *shape: int) -> np.ndarray:
        return spread * sd * rng.standard_normal(shape)

    durations = np.array([0.22, 0.30, 0.35]) * (1.0 + scatter(0.06, 3))  # rise, under, cushion [s]
    wrist = np.array([[0.03, 0.02], [0.03, 0.08], [0.0, 0.02]]) + scatter(0.012, 3, 2)
    wrist_speed = np.array([0.75, 0.3]) + scatter(0.15, 2)
    pitch = np.deg2rad([35.0, 30.0, 22.0]) + scatter(np.deg2rad(4.0), 3)
    rate = pitch_rate * (1.0 + float(scatter(0.08)))
    still = np.zeros((2, 2))
    return HandScript(
        np.concatenate([[0.0], PAUSE + np.concatenate([[0.0], np.cumsum(durations)])]),
        np.vstack([still, wrist]),
        np.vstack([still, wrist_speed, still]),
        np.concatenate([[0.0, 0.0], pitch]),
        np.array([0.0, 0.0, rate, 0.0, 0.0]),
    )


def reach(rng: np.random.Generator, spread: float = 1.0) -> ReachScript:
    """A reach of half a metre in 2 s, from `REACH_HOME` to `REACH_GOAL` with an arc of 6 cm.

    Args:
        rng: what makes this demonstration differ from the next.
        spread: 0 for the hand's intention, 1 for a person's scatter about it.
        pitch_rate: intended at the release [rad/s].
    """
    goal = REACH_GOAL + spread * 0.01 * rng.standard_normal(3)
    arc = np.array([0.0, 0.0, 0.06]) + spread * 0.01 * rng.standard_normal(3)
    duration = 2.0 * (1.0 + spread * 0.05 * float(rng.standard_normal()))
    warp = spread * float(np.clip(0.1 * rng.standard_normal(), -0.3, 0.3))
    return ReachScript(goal, arc, duration, warp)


class Skill(NamedTuple):
    """What the hand can show.

    Attributes:
        home: Posture in which it takes the pan [rad]. Shape (7,)
        scatter: Of that posture, standard deviation [rad].
        script: Draws a demonstration.
    """

    home: np.ndarray
    scatter: float
    script: Callable[[np.random.Generator], Script]


SKILLS = {"flip": Skill(HOME, 0.0, wrist_flick), "reach": Skill(REACH_HOME, 0.008, reach)}


class Hand:
    """A hand that follows a script from the pose in which it takes the pan."""

    def __init__(self, script: Script, position: np.ndarray, rotation: np.ndarray) -> None:
        """Take the pan at `position` (3,) [m], `rotation` (3, 3)."""
        self.script = script
        self._position, self._rotation = position, rotation
        self._relax = 0.3  # [s] in which the hand lets go

    def target(self, t: float) -> Target:
        """What it wants at time t since it took the pan [s]."""
        return self.script.target(t, self._position, self._rotation)

    def wrench(
        self, t: float, position: np.ndarray, rotation: np.ndarray, twist: np.ndarray
    ) -> np.ndarray | None:
        """Force [N] and moment [N m] (6,) at the pan's centre; None once the hand has let go.

        Args:
            t: since the hand took the pan [s].
            position: of the pan [m]. Shape (3,)
            rotation: of the pan. Shape (3, 3)
            twist: its velocity [m/s] and angular velocity [rad/s]. Shape (6,)
        """
        late = max(t - self.script.end, 0.0)
        if late > self._relax:
            return None
        p, r, v, omega = self.target(t)
        grip = 1.0 - late / self._relax
        force = STIFFNESS * (p - position) + DAMPING * (v - twist[:3])
        moment = ROTATION_STIFFNESS * rotations.log(r @ rotation.T) + ROTATION_DAMPING * (
            omega - twist[3:]
        )
        force *= grip * min(1.0, FORCE_MAX / max(float(np.linalg.norm(force)), 1e-9))
        moment *= grip * min(1.0, MOMENT_MAX / max(float(np.linalg.norm(moment)), 1e-9))
        return np.concatenate([force, moment])
