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

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.tasks.flip.ballistic_fit import GRAVITY
from wam_power_ros.tasks.flip.frames import DELTA_H, PAN_RADIUS, PANCAKE_RADIUS

RIM_HEIGHT = 0.035  # [m]
RIM_FLARE = 0.6  # outward, from the pan's normal [rad]
RIM_TOP = PAN_RADIUS + RIM_HEIGHT * math.tan(RIM_FLARE)  # along the floor [m]
FOOT = 0.0025  # height up to which the pancake's side meets the foot of the rim [m]
CONTACT_GAP = 0.015  # gap below which a contact may come within a step [m]
CONTACT_DEPTH = 0.03  # depth beyond which a body is on the other side of a surface [m]
SWEEPS = 6

_Name = tuple[str, int]  # of a contact: surface of the pan, and end of the pancake or side


class Pancake(NamedTuple):
    """Numbers of a pancake that nobody measures."""

    radius: float = PANCAKE_RADIUS  # [m]
    friction: float = 0.2  # coefficient between pancake and pan [1]
    # Drag slows the spin by d omega / dt = -spin_decay omega^2 [1/rad], the more the larger and
    # lighter the pancake is, and the pancake by dv / dt = -drag v^2 [1/m].
    spin_decay: float = 0.4
    drag: float = 0.35


PANCAKE = Pancake()  # of 9 cm and 26 g


def predict_toss(pan: EndEffectorPath, pancake: Pancake = PANCAKE) -> Mapping[str, float]:
    """Errors of the toss of a pan that moves along a path in the x-z plane.

    They are those where it falls through `DELTA_H` above the pan; of one that stays lower, at its
    highest point above the pan, where only that share of its rotation counts: what tilts with the
    pan has not turned. So they are known however weak a toss is, without a jump at `DELTA_H`.
    At first the pancake lies in the middle of the pan, or at the lower rim of one so tilted that it
    slides. It may leave the plane with the pan, but not by itself. The path is evenly sampled.
    """
    radius, friction, spin_decay, drag = pancake
    dt, gyration, path = float(pan.t[1] - pan.t[0]), 0.5 * radius, _plane(pan)
    px, pz, tilt, y, *_, c, s = path[0]
    along = 0.0
    if abs(math.tan(tilt)) > friction:
        along = math.copysign(PAN_RADIUS - radius, -tilt)
    x, z, u, vx, vz, vu = px + along * c, pz + along * s, gyration * tilt, 0.0, 0.0, 0.0
    pushed: dict[_Name, list[float]] = {}  # impulses along normal and surface, for a mass of 1
    tossed, start, highest, above = False, pz, 0.0, -math.inf
    for px, pz, pitch, py, pvx, pvz, rate, c, s in path[1:]:
        slowed = 1.0 - dt * drag * math.hypot(vx, vz)
        vx, vz = vx * slowed, vz * slowed - dt * GRAVITY
        vu -= dt * spin_decay * abs(vu) * vu / gyration
        rows, before, pushed = [], pushed, {}
        for name, gap, lx, lz, nx, nz in _touches(x - px, z - pz, u / gyration, radius, c, s):
            ax, az = x + lx - px, z + lz - pz
            wx, wz = pvx - rate * az, pvz + rate * ax  # of the pan there
            nu, tu = (lx * nz - lz * nx) / gyration, -(lx * nx + lz * nz) / gyration
            # A gap may close within the step; a share of a depth is restored, not too fast.
            apart = -gap / dt if gap > 0.0 else min(-0.2 * gap / dt, 0.3)
            impulse = pushed[name] = list(before.get(name, (0.0, 0.0)))
            normal, tangent = impulse
            rows.append((nx, nz, nu, tu, apart + wx * nx + wz * nz, wx * nz - wz * nx, impulse))
            vx += normal * nx + tangent * nz
            vz += normal * nz - tangent * nx
            vu += normal * nu + tangent * tu
        for _ in range(SWEEPS if rows else 0):
            for nx, nz, nu, tu, apart, slide, impulse in rows:
                error = apart - (vx * nx + vz * nz + vu * nu)
                normal = impulse[0] + error / (1.0 + nu * nu)
                normal = normal if normal > 0.0 else 0.0  # faster than max
                change, most = normal - impulse[0], friction * normal
                vx, vz, vu = vx + change * nx, vz + change * nz, vu + change * nu
                error = slide - (vx * nz - vz * nx + vu * tu)
                tangent = impulse[1] + error / (1.0 + tu * tu)
                tangent = most if tangent > most else -most if tangent < -most else tangent
                change = tangent - impulse[1]
                vx, vz, vu = vx + change * nz, vz - change * nx, vu + change * tu
                impulse[0], impulse[1] = normal, tangent
        pushed = {name: each for name, each in pushed.items() if each[0] > 0.0}
        x, z, u = x + dt * vx, z + dt * vz, u + dt * vu
        highest = max(highest, z - start)
        y = py if pushed else y
        if tossed or z - pz > above:
            above = z - pz
            share = 1.0 if tossed else min(max(above / DELTA_H, 0.0), 1.0)
            rotation = share * (u / gyration - tilt) - math.pi
            landing = {"landing_x": x - px, "landing_y": y - py, "catch_pitch": pitch}
        if tossed and above <= DELTA_H:
            break
        tossed = above > DELTA_H
    return {"rotation": rotation, **landing, "apex": highest}


def _plane(pan: EndEffectorPath) -> list[list[float]]:
    """Rows of x, z, pitch and y of the pan, velocities of the first three, cos and sin of pitch."""
    normal = rotations.matrix(pan.quat_xyzw)[:, :, 2]
    pitch = np.unwrap(np.arctan2(-normal[:, 0], normal[:, 2]))  # front edge up
    pose = np.column_stack([pan.position[:, [0, 2]], pitch])
    rates = np.gradient(pose, pan.t[1] - pan.t[0], axis=0)
    columns = [pose, pan.position[:, 1], rates, np.cos(pitch), np.sin(pitch)]
    rows: list[list[float]] = np.column_stack(columns).tolist()
    return rows


def _touches(
    dx: float, dz: float, pitch: float, radius: float, c: float, s: float
) -> Iterator[tuple[_Name, float, float, float, float, float]]:
    """What a pancake at (dx, dz) from a pan of pitch (c, s) touches, or may within a step.

    Each has its name, the gap between the bodies, its position from the pancake's centre, and the
    unit vector along which the pan pushes, x and z each.
    """
    if max(abs(dx), abs(dz)) > RIM_TOP + radius:
        return
    cos, sin = math.cos(pitch), math.sin(pitch)
    wall, flare = math.cos(RIM_FLARE), math.sin(RIM_FLARE)
    for end in (1, -1):
        lx, lz = end * radius * cos, end * radius * sin
        along, height = (dx + lx) * c + (dz + lz) * s, (dz + lz) * c - (dx + lx) * s
        if -CONTACT_DEPTH < height < CONTACT_GAP and abs(along) < PAN_RADIUS + CONTACT_GAP:
            yield ("floor", end), height, lx, lz, -s, c
        side = 1 if along > 0.0 else -1
        gap, inward = (PAN_RADIUS - side * along) * wall + height * flare, -side * wall
        nx, nz = inward * c - flare * s, inward * s + flare * c
        if height < FOOT:
            gap, nx, nz = PAN_RADIUS - side * along, -end * cos, -end * sin
        if -CONTACT_DEPTH < height < RIM_HEIGHT and -CONTACT_DEPTH < gap < CONTACT_GAP:
            yield ("wall", end), gap, lx, lz, nx, nz
    up = 1.0 if cos * c + sin * s > 0.0 else -1.0  # the face above
    for side in (1, -1):
        along = side * RIM_TOP
        lx, lz = along * c - RIM_HEIGHT * s - dx, along * s + RIM_HEIGHT * c - dz
        gap = up * (lx * sin - lz * cos)
        if abs(lx * cos + lz * sin) < radius and -CONTACT_GAP < gap < CONTACT_GAP:
            yield ("top", side), gap, lx, lz, -up * sin, up * cos
