# SPDX-License-Identifier: Apache-2.0
"""Prediction of a policy's toss before any rollout: the movement of Eq. 1, then free flight.

The pan follows Eq. 1 exactly. The pancake lies at its centre and leaves when the pan's
acceleration along its normal falls below gravity's; it keeps the pan's velocity and a share of its
rotation, and flies without drag. That is crude, but it ranks policies, which is all that the
screening of candidates needs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.dmp import activations
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.tasks.flip.flight import DELTA_H
from wam_power_ros.tasks.flip.returns import LandingWeights, PancakeWeights

GRAVITY = 9.81  # [m/s^2]
PERIOD = 0.005  # [s] of the planned movement; 0.002 predicts no better
TAIL = 1.0  # [s] after the movement, in the time of the demonstration, that is predicted as well
CATCH_RADIUS = 0.1  # [m] of landing error at which a catch has become unlikely
SPIN_SHARE = 0.6  # of the pan's turning that the pancake keeps; fits tosses of tuning seeds
RIDGE = (0.05 / 0.3) ** 2  # of `TossModel`: scatter of a return, over that of w before a rollout


@dataclass(frozen=True, eq=False)
class Tosses:
    """Planned tosses of B policies.

    Attributes:
        tossed: Whether the pancake rises above the pan by more than Delta_h. Shape (B,).
        angle: Rotation when it falls through that height [rad]; 0 when not tossed. Shape (B,).
        apex: Highest point above the pan's height at the start [m]. Shape (B,).
        landing_error: Position of pancake less pan at that time, x and y [m]. Shape (B, 2).
    """

    tossed: np.ndarray
    angle: np.ndarray
    apex: np.ndarray
    landing_error: np.ndarray


def plan_tosses(parameters: Parametrization, z: np.ndarray, start: np.ndarray) -> Tosses:
    """Predicted tosses of many policies.

    Args:
        parameters: Parametrization of the policies.
        z: Coordinates. Shape (B, size).
        start: Position of the pan's centre at the start, base frame [m]. Shape (3,).
    """
    position, velocity, rotation, omega = _movement(parameters, z, start)
    tempo = parameters.tempo(z)  # (B,); the movement is in the time of the demonstration
    velocity, omega, period = velocity * tempo, omega * tempo, PERIOD / tempo
    steps = len(position)
    normal = _normals(rotation, parameters.policy0.orientation_reference)  # (T, 3, B)
    acceleration = np.gradient(velocity, axis=0) / period
    acceleration[:, 2] += GRAVITY
    free = (acceleration * normal).sum(axis=1) < 0.0  # (T, B)
    left = free.any(axis=0)
    release = np.where(left, free.argmax(axis=0), steps - 1)  # (B,)
    everyone = np.arange(len(release))

    t = np.maximum(np.arange(steps)[:, None] - release, 0) * period  # (T, B) of the flight
    at = position[release, :, everyone].T  # (3, B)
    flying = at + velocity[release, :, everyone].T * t[:, None]  # (T, 3, B)
    flying[:, 2] -= 0.5 * GRAVITY * t**2
    above = (flying[:, 2] - position[:, 2] > DELTA_H) & (t > 0.0)
    tossed = left & above.any(axis=0)
    # the last instant above it: a pan that follows the pancake upwards crosses more than once
    down = np.where(tossed, steps - 1 - above[::-1].argmax(axis=0), steps - 1)  # (B,)
    # turned in the pan, then with a share of its angular velocity
    turned = (normal[0] * normal[release, :, everyone].T).sum(axis=0)
    spin = np.linalg.norm(omega[release, :, everyone], axis=-1)
    angle = np.arccos(np.clip(turned, -1.0, 1.0)) + SPIN_SHARE * spin * t[down, everyone]
    miss = (flying - position)[down, :2, everyone]  # (B, 2)
    rise = np.where(t > 0.0, flying[:, 2], position[:, 2]).max(axis=0) - start[2]
    return Tosses(
        tossed=tossed,
        angle=np.where(tossed, angle, 0.0),
        apex=np.where(left, rise, 0.0),
        landing_error=np.where(tossed[:, None], miss, 0.0),
    )


def planned_terms(tosses: Tosses, weights: PancakeWeights | LandingWeights) -> np.ndarray:
    """Terms of the return of planned tosses.

    Args:
        tosses: Planned tosses of B policies.
        weights: Weights of Eq. 5 (terms orientation, position, altitude), or of `landing_return`
            (terms rotation, altitude, landing, caught).

    Returns:
        Shape (B, 3) or (B, 4).
    """
    miss = np.linalg.norm(tosses.landing_error, axis=1)
    apex = np.maximum(tosses.apex, 0.0)
    if isinstance(weights, PancakeWeights):
        folded = np.arccos(np.cos(tosses.angle)) / np.pi
        return np.stack(
            [
                weights.orientation * folded,
                weights.position * np.exp(-miss),
                weights.altitude * apex,
            ],
            axis=1,
        )
    turned = np.maximum(0.0, 1.0 - np.abs(tosses.angle - np.pi) / np.pi)
    turned = np.where(tosses.tossed, turned, 0.0)
    height = np.minimum(apex, weights.altitude_cap) / weights.altitude_cap
    return np.stack(
        [
            weights.rotation * turned,
            weights.altitude * height,
            weights.landing * turned**2 * np.exp(-miss / weights.landing_scale),
            weights.caught * turned**2 * np.exp(-((miss / CATCH_RADIUS) ** 2)),
        ],
        axis=1,
    )


class TossModel:
    """A `learner.Model`: the return of the planned toss, corrected by the returns of rollouts.

    The return is modelled as sum_j (1 + w_j) term_j + w_0, with the terms of the planned toss and
    w normal about zero: a ridge regression, solved anew after every rollout.
    """

    def __init__(
        self,
        parameters: Parametrization,
        start: np.ndarray,
        weights: PancakeWeights | LandingWeights | None = None,
    ) -> None:
        """Start without any rollout.

        Args:
            parameters: Parametrization of the policies.
            start: Position of the pan's centre at the start, base frame [m]. Shape (3,).
            weights: Weights of the return; the paper's of Eq. 5 when omitted.
        """
        self._parameters, self._start = parameters, np.asarray(start, dtype=float)
        self._weights = PancakeWeights() if weights is None else weights
        self._terms: list[np.ndarray] = []
        self._left_over: list[float] = []
        self._w: np.ndarray | None = None  # of the terms and a constant, None before a rollout

    def predict(self, z: np.ndarray) -> np.ndarray:
        """Returns to expect at z (B, size). Shape (B,)."""
        terms = self._planned(z)
        known = terms.sum(axis=1)
        return known if self._w is None else known + self._features(terms) @ self._w

    def learn(self, z: np.ndarray, ret: float) -> None:
        """Take in that z (size,) returned `ret`."""
        terms = self._planned(z[np.newaxis])
        self._terms.append(self._features(terms)[0])
        self._left_over.append(ret - float(terms.sum()))
        x, y = np.stack(self._terms), np.array(self._left_over)
        self._w = np.linalg.solve(x.T @ x + RIDGE * np.eye(x.shape[1]), x.T @ y)

    def _planned(self, z: np.ndarray) -> np.ndarray:
        return planned_terms(plan_tosses(self._parameters, z, self._start), self._weights)

    @staticmethod
    def _features(terms: np.ndarray) -> np.ndarray:
        return np.column_stack([terms, np.full(len(terms), 0.5)])


def _movement(
    parameters: Parametrization, z: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Eq. 1 and the same law of the rotation vector: x, xd, r, rd. Shape (T, 3, B) each."""
    policy = parameters.policy0
    stiffness, attractors, rotation = parameters.arrays(z)
    count = len(stiffness)
    n = policy.basis.count
    steps = round((policy.basis.duration + TAIL) / PERIOD) + 1
    h = activations(policy.basis, np.arange(steps - 1) * PERIOD)  # (T-1, n)
    force = np.matmul(stiffness, attractors[..., None])[..., 0]  # (B, n, 3)
    a = PERIOD * (h @ stiffness.transpose(1, 2, 3, 0).reshape(n, -1)).reshape(-1, 3, 3, count)
    b = PERIOD * (h @ force.transpose(1, 2, 0).reshape(n, -1)).reshape(-1, 3, count)
    c = (h @ rotation.transpose(1, 2, 0).reshape(n, -1)).reshape(-1, 3, count)
    c *= PERIOD * policy.rotation_stiffness
    keep = 1.0 - PERIOD * policy.damping
    rotation_keep = 1.0 - PERIOD * policy.rotation_damping
    pull = PERIOD * policy.rotation_stiffness
    x, xd, r, rd = np.zeros((4, steps, 3, count))
    x[0] = start[:, None]
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(steps - 1):
            xd[k + 1] = keep * xd[k] + b[k] - (a[k] * x[k]).sum(axis=1)
            x[k + 1] = x[k] + PERIOD * xd[k + 1]
            rd[k + 1] = rotation_keep * rd[k] + c[k] - pull * r[k]
            r[k + 1] = r[k] + PERIOD * rd[k + 1]
    return x, xd, r, rd


def _normals(rotation: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Pan's normal when turned by rotation vectors (T, 3, B) from `reference` (xyzw). Same."""
    axis = rotations.matrix(reference[np.newaxis])[0][:, 2]  # (3,)
    angle = np.linalg.norm(rotation, axis=1, keepdims=True)  # (T, 1, B)
    unit = rotation / np.maximum(angle, 1e-12)
    along = (unit * axis[:, None]).sum(axis=1, keepdims=True)
    # Rodrigues: v cos + (u x v) sin + u (u.v) (1 - cos)
    turned = axis[:, None] * np.cos(angle) + unit * along * (1.0 - np.cos(angle))
    across = np.cross(unit.swapaxes(1, 2), axis).swapaxes(1, 2)  # (T, 3, B)
    return turned + across * np.sin(angle)
