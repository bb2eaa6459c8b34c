# SPDX-License-Identifier: Apache-2.0
"""Toss of a pancake by a pan that moves along a path, in the plane of the toss.

Seen from the side, the pancake is a rigid rod. Its ends touch the floor of the pan, the foot of the
rim with their sides, and the flared rim; its face touches the rim's top. So it slides, falls back
after a dip, is braked by the rim and rolls over its edge. Contacts push, rub (Coulomb) and do not
rebound. The impulses of all contacts of a step are solved for together, as in [Stewart1996], by
projected Gauss-Seidel sweeps.

In coordinates x, z and radius of gyration times pitch, the mass matrix is the identity times the
mass, which matters nowhere. Plain numbers: a step is too small for arrays to be faster.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.tasks.flip.ballistic_fit import GRAVITY
from wam_power_ros.tasks.flip.flight import DELTA_H
from wam_power_ros.tasks.flip.frames import PAN_RADIUS, PANCAKE_RADIUS

RIM_HEIGHT = 0.035  # [m]
RIM_FLARE = 0.6  # outward, from the pan's normal [rad]
FOOT = 0.0025  # height up to which the pancake's side meets the foot of the rim [m]
RIM_TOP = PAN_RADIUS + RIM_HEIGHT * math.tan(RIM_FLARE)  # along the floor [m]
NEAR = 0.015  # gap below which a contact may come within a step [m]
DEEP = 0.03  # depth beyond which a body is on the other side of a surface [m]
SWEEPS = 6
RESTORED = 0.2  # share of a depth that is restored in a step
RESTORED_MAX = 0.3  # speed at which it is, at most [m/s]


class Pancake(NamedTuple):
    """Numbers of a pancake that nobody measures.

    Attributes:
        radius: Radius of the pancake [m].
        friction: Coefficient of friction between pancake and pan [1].
        spin_decay: Drag slows the spin by d omega / dt = -spin_decay omega^2 [1/rad], the more the
            larger and lighter it is.
        drag: Drag slows the pancake by dv / dt = -drag v^2 [1/m].
    """

    radius: float = PANCAKE_RADIUS
    friction: float = 0.2
    spin_decay: float = 0.4
    drag: float = 0.35


class Toss(NamedTuple):
    """A predicted toss.

    Attributes:
        tossed: True if the pancake rises above the pan by more than Delta_h.
        angle: Rotation when it falls through that height [rad]; 0 if not tossed.
        landing_error: Position of pancake minus pan along x and y at that time [m]; 0 if not
            tossed.
        catch_pitch: Pitch of the pan at that time, positive with its front edge up [rad]; 0 if not
            tossed.
    """

    tossed: bool
    angle: float = 0.0
    landing_error: tuple[float, float] = (0.0, 0.0)
    catch_pitch: float = 0.0


class _Pan(NamedTuple):
    """Pan at one time: position, pitch with its cosine and sine, and velocities."""

    x: float
    z: float
    pitch: float
    y: float
    vx: float
    vz: float
    rate: float
    cos: float
    sin: float


class _Touch(NamedTuple):
    """A possible contact.

    Attributes:
        name: Name of the pan's surface, and 1 or -1 for the front or rear end of the pancake (or
            side of the pan, for the rim's top) that touches it.
        gap: Distance between the bodies, negative if they overlap [m].
        lever: Position of the contact minus that of the pancake's centre, x and z [m].
        normal: Unit vector along which the pan pushes the pancake, x and z [1].
    """

    name: tuple[str, int]
    gap: float
    lever: tuple[float, float]
    normal: tuple[float, float]


def predict_toss(
    pan: EndEffectorPath, delta_h: float = DELTA_H, pancake: Pancake | None = None
) -> Toss:
    """Predict the toss of a pan that moves along a path in the x-z plane.

    At first the pancake lies in the middle of the pan, or at the lower rim of one so tilted that it
    slides. It may leave the plane with the pan, but not by itself.

    Args:
        pan: Path of the pan, evenly sampled.
        delta_h: Height above the pan at which the flight ends [m].
        pancake: Its numbers; by default those of a pancake of 9 cm and 26 g.
    """
    radius, friction, spin_decay, drag = pancake or Pancake()
    dt, path = _plane(pan)
    gyration, first = 0.5 * radius, path[0]
    tilted = abs(math.tan(first.pitch)) > friction
    along = math.copysign(PAN_RADIUS - radius, -first.pitch) if tilted else 0.0
    x, z, u = first.x + along * first.cos, first.z + along * first.sin, gyration * first.pitch
    vx = vz = vu = 0.0
    y, tossed = first.y, False
    pushed: dict[tuple[str, int], tuple[float, float]] = {}
    for now in path[1:]:
        slowed = dt * drag * math.hypot(vx, vz)
        vx, vz = vx - slowed * vx, vz - slowed * vz - dt * GRAVITY
        vu -= dt * spin_decay * abs(vu) * vu / gyration
        touches = _touches(x, z, u / gyration, radius, now)
        pushed, (vx, vz, vu) = _push(
            touches, (x, z), (vx, vz, vu), now, (gyration, friction, dt), pushed
        )
        x, z, u = x + dt * vx, z + dt * vz, u + dt * vu
        if pushed:
            y = now.y
        if z - now.z > delta_h:
            tossed = True
        elif tossed:
            return Toss(True, u / gyration - first.pitch, (x - now.x, y - now.y), now.pitch)
    return Toss(False)


def _plane(pan: EndEffectorPath) -> tuple[float, list[_Pan]]:
    """Sampling period [s] and motion of the pan."""
    dt = float(pan.t[1] - pan.t[0])
    normal = rotations.matrix(pan.quat_xyzw)[:, :, 2]
    pitch = np.unwrap(np.arctan2(-normal[:, 0], normal[:, 2]))  # front edge up
    pose = np.column_stack([pan.position[:, [0, 2]], pitch, pan.position[:, 1]])
    rates = np.gradient(pose[:, :3], dt, axis=0)
    rows = np.column_stack([pose, rates, np.cos(pitch), np.sin(pitch)])
    return dt, list(itertools.starmap(_Pan, rows.tolist()))


def _touches(x: float, z: float, pitch: float, radius: float, pan: _Pan) -> list[_Touch]:
    """What the pancake touches, or may touch within a step."""
    touches: list[_Touch] = []
    px, pz, c, s = pan.x, pan.z, pan.cos, pan.sin
    if max(abs(x - px), abs(z - pz)) > RIM_TOP + radius:
        return touches
    cos, sin = math.cos(pitch), math.sin(pitch)
    wall, flare = math.cos(RIM_FLARE), math.sin(RIM_FLARE)
    for end in (1, -1):
        lever = end * radius * cos, end * radius * sin
        dx, dz = x + lever[0] - px, z + lever[1] - pz
        along, height = dx * c + dz * s, dz * c - dx * s
        if -DEEP < height < NEAR and abs(along) < PAN_RADIUS + NEAR:
            touches.append(_Touch(("floor", end), height, lever, (-s, c)))
        if -DEEP < height < RIM_HEIGHT:
            side = 1 if along > 0.0 else -1
            gap, inward = (PAN_RADIUS - side * along) * wall + height * flare, -side * wall
            normal = inward * c - flare * s, inward * s + flare * c
            if height < FOOT:
                gap, normal = PAN_RADIUS - side * along, (-end * cos, -end * sin)
            if -DEEP < gap < NEAR:
                touches.append(_Touch(("wall", end), gap, lever, normal))
    up = 1.0 if cos * c + sin * s > 0.0 else -1.0  # the face above
    for side in (1, -1):
        along = side * RIM_TOP
        lever = px + along * c - RIM_HEIGHT * s - x, pz + along * s + RIM_HEIGHT * c - z
        gap = up * (lever[0] * sin - lever[1] * cos)
        if abs(lever[0] * cos + lever[1] * sin) < radius and -NEAR < gap < NEAR:
            touches.append(_Touch(("top", side), gap, lever, (-up * sin, up * cos)))
    return touches


def _push(
    touches: list[_Touch],
    centre: tuple[float, float],
    velocity: tuple[float, float, float],
    pan: _Pan,
    numbers: tuple[float, float, float],
    before: dict[tuple[str, int], tuple[float, float]],
) -> tuple[dict[tuple[str, int], tuple[float, float]], tuple[float, float, float]]:
    """Impulses of the contacts, and the velocity after them, of which none closes a gap.

    Args:
        touches: Possible contacts.
        centre: Position of the pancake's centre, x and z [m].
        velocity: Velocity of the pancake along x and z, and radius of gyration times rate [m/s].
        pan: Pan at the end of the step.
        numbers: Radius of gyration [m], coefficient of friction [1] and length of the step [s].
        before: Impulses of the step before, along normal and surface, for a mass of 1 [m/s].
    """
    (gyration, friction, dt), (vx, vz, vu) = numbers, velocity
    rows: list[list[float]] = []
    for name, gap, (lx, lz), (nx, nz) in touches:
        ax, az = centre[0] + lx - pan.x, centre[1] + lz - pan.z
        wx, wz = pan.vx - pan.rate * az, pan.vz + pan.rate * ax  # of the pan there
        nu, tu = (lx * nz - lz * nx) / gyration, -(lx * nx + lz * nz) / gyration
        apart = -gap / dt if gap > 0.0 else min(-RESTORED * gap / dt, RESTORED_MAX)
        wanted = apart + wx * nx + wz * nz, wx * nz - wz * nx
        normal, tangent = before.get(name, (0.0, 0.0))
        rows.append([nx, nz, nu, tu, *wanted, normal, tangent])
        vx += normal * nx + tangent * nz
        vz += normal * nz - tangent * nx
        vu += normal * nu + tangent * tu
    for _ in range(SWEEPS if rows else 0):
        for row in rows:
            nx, nz, nu, tu, apart, along, normal, tangent = row
            error = apart - (vx * nx + vz * nz + vu * nu)
            row[6] = max(normal + error / (1.0 + nu * nu), 0.0)
            most = friction * row[6]
            change = row[6] - normal
            vx, vz, vu = vx + change * nx, vz + change * nz, vu + change * nu
            error = along - (vx * nz - vz * nx + vu * tu)
            row[7] = min(max(tangent + error / (1.0 + tu * tu), -most), most)
            change = row[7] - tangent
            vx, vz, vu = vx + change * nz, vz - change * nx, vu + change * tu
    pushed = {touch.name: (row[6], row[7]) for touch, row in zip(touches, rows, strict=True)}
    return {name: each for name, each in pushed.items() if each[0] > 0.0}, (vx, vz, vu)
