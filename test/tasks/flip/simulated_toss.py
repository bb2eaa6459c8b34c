# SPDX-License-Identifier: Apache-2.0
"""Simulated toss of a light disc in air, and its motion-capture frames, for tests."""

import math
from dataclasses import dataclass

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.tasks.flip.frames import DELTA_H

STEP = 0.0005  # time step [s]
END = 2.0  # end of the simulation [s]
FALL = 0.1  # time in which it falls flat after landing on its edge [s]
GRAVITY = 9.81  # [m/s^2]
RADIUS = 0.09  # [m]


@dataclass(frozen=True)
class Toss:
    """Ground truth of a toss at every step, and the path of the pan."""

    t: np.ndarray  # (T,)
    pan: EndEffectorPath
    position: np.ndarray  # (T, 3)
    matrix: np.ndarray  # (T, 3, 3) body frame; the body's own axes are arbitrary
    normal: np.ndarray  # (T, 3)
    winding: np.ndarray  # (T,) rotation from rest in the plane normal to the spin axis [rad]
    release: float
    t_f: float


def toss(
    rng: np.random.Generator,
    vz: float | None = None,
    half_turns: float | None = None,
    air: float = 1.0,
    precession: float = 0.0,
) -> Toss:
    """A disc that leaves a moving, tilted pan, flies through air and comes to rest in the pan.

    `air` scales a drag that depends on the attitude (0.15/m edge on to 0.45/m face on), a decay
    of the spin and a draught of 0.1 m/s.
    """
    t = np.arange(0.0, END, STEP)
    vz = rng.uniform(1.9, 2.7) if vz is None else vz
    release = rng.uniform(0.35, 0.6)
    late = np.maximum(t - release, 0.0)
    # Pan: it dips and tilts until the release, then slows down and moves under the pancake.
    share = np.clip(t / release, 0.0, 1.0)
    tilt = rng.uniform(0.0, 0.25)
    pan_z = 0.9 - 0.08 * np.sin(math.pi * share) ** 2 + 0.05 * (1.0 - np.exp(-late / 0.05))
    pan_x = 0.6 + 0.1 * share + 0.05 * (1.0 - np.exp(-late / 0.1))
    tilts = (tilt * share**2 - 0.3 * np.sin(math.pi * share)) * np.exp(-late / 0.1)
    vectors = np.stack([0.0 * t, -tilts, 0.0 * t], axis=1)
    pan_position = np.stack([pan_x, 0.02 * share, pan_z], axis=1)
    pan_matrix = rotations.exp(vectors)
    every = slice(None, None, round(0.01 / STEP))
    pan = EndEffectorPath(
        "t", t[every], pan_position[every], rotations.quat_of_vector(vectors[every])
    )
    # Flight.
    k = int(np.searchsorted(t, release))
    centre = pan_position + 0.0025 * pan_matrix[:, :, 2]
    position = centre.copy()
    flight_time = 2.0 * vz / GRAVITY
    turns = rng.uniform(0.0, 300.0 / 180.0) if half_turns is None else half_turns
    rate = max(turns * math.pi - tilt, 0.0) / flight_time
    axis = rotations.exp([0.0, 0.0, rng.uniform(-0.3, 0.3)]) @ [0.0, -1.0, 0.0]
    # A symmetric top: the normal turns about a fixed axis that leans towards it by the precession.
    axis = axis + precession * pan_matrix[k, :, 2]
    axis /= np.linalg.norm(axis)
    decay = 0.12 * air  # the torque of the drag is proportional to the square of the spin
    turned = np.log1p(decay * rate * late) / decay if decay else rate * late
    attitude = rotations.exp(turned[:, None] * axis)
    matrix = np.where((t >= release)[:, None, None], attitude @ pan_matrix[k], pan_matrix)
    normal = matrix[:, :, 2]
    v = np.array([rng.uniform(-0.1, 0.4), rng.uniform(-0.1, 0.1), vz])
    wind = np.array([*rng.normal(0.0, 0.1, 2), 0.0]) * air
    landed = len(t)
    for i in range(k, len(t) - 1):
        relative = v - wind
        speed = np.linalg.norm(relative)
        facing = abs(relative @ normal[i]) / max(speed, 1e-9)
        a = -air * (0.15 + 0.3 * facing) * speed * relative
        a[2] -= GRAVITY
        position[i + 1] = position[i] + STEP * v + 0.5 * STEP**2 * a
        v = v + STEP * a
        gap = pan_matrix[i + 1, :, 2] @ (position[i + 1] - pan_position[i + 1])
        if i > k + 100 and gap < RADIUS * math.sqrt(max(0.0, 1.0 - normal[i + 1, 2] ** 2)):
            landed = i + 1
            break
    # After the landing it falls on the side that is lower, and lies flat.
    on = position[landed:]
    side = np.sign(normal[landed - 1, 2])
    stay = position[landed - 1] - pan_position[landed - 1] if landed < len(t) else np.zeros(3)
    stay = np.array([*np.clip(stay[:2], -0.04, 0.04), 0.0025])
    on[:] = pan_position[landed:] + np.einsum("tij,j->ti", pan_matrix[landed:], stay)
    last, flat = matrix[landed - 1], side * pan_matrix[landed:, :, 2]
    over = np.cross(last[:, 2], flat)
    sine = np.linalg.norm(over, axis=1)
    angle = np.arctan2(sine, flat @ last[:, 2]) * np.clip((t[landed:] - t[landed - 1]) / FALL, 0, 1)
    matrix[landed:] = rotations.exp((angle / np.maximum(sine, 1e-12))[:, None] * over) @ last
    body = rotations.exp(rng.normal(size=3))
    across = np.cross(axis, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    winding = np.unwrap(np.arctan2(matrix[:, :, 2] @ across, matrix[:, 2, 2]))
    above = position[:, 2] - pan_z - DELTA_H
    apex = k + int(np.argmax(position[k:landed, 2]))
    low = np.flatnonzero(above[apex:] <= 0.0)
    t_f = math.nan
    if len(low) and above[apex] > 0.0:
        j = apex + int(low[0])
        t_f = float(t[j] - STEP * above[j] / (above[j] - above[j - 1]))
    return Toss(t, pan, position, matrix @ body, matrix[:, :, 2].copy(), winding, release, t_f)


def capture(
    toss: Toss,
    rng: np.random.Generator,
    rate: float = 30.0,
    noise: float = 1.0,
    dropout: float = 0.0,
) -> BodyPath:
    """Motion-capture frames of the pancake: random phase, noise, missing frames."""
    t = np.arange(rng.uniform(0.0, 1.0 / rate), END - 0.01, 1.0 / rate)
    t = t[(rng.uniform(size=len(t)) >= dropout) | (t < 0.1)]
    index = np.rint(t / STEP).astype(int)
    position = toss.position[index] + noise * rng.normal(0.0, 0.00025, (len(t), 3))
    jitter = rotations.exp(noise * rng.normal(0.0, 0.0035, (len(t), 3)))
    return BodyPath("t", toss.t[index], position, rotations.quat_xyzw(jitter @ toss.matrix[index]))


def without(path: BodyPath, lost: np.ndarray) -> BodyPath:
    """Path without the frames marked by `lost`."""
    return BodyPath(path.id, path.t[~lost], path.position[~lost], path.quat_xyzw[~lost])


def at(toss: Toss, t: float, values: np.ndarray) -> np.ndarray:
    """Interpolate ground truth at a time between two steps."""
    k = int(t / STEP)
    return values[k] + (t / STEP - k) * (values[k + 1] - values[k])
