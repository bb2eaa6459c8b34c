# SPDX-License-Identifier: Apache-2.0
"""Prediction of the return (Eq. 5) of a policy's toss before any rollout: Eq. 1, then free flight.

The pan follows Eq. 1 exactly. The pancake lies at its centre and is released when the acceleration
of the pan along its normal falls below that of gravity. It then has the velocity of the pan and a
fraction of its angular velocity, and flies without drag. The model is crude, but it ranks policies,
which suffices for the screening of candidates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.dmp import activations
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.tasks.flip.ballistic_fit import GRAVITY
from wam_power_ros.tasks.flip.flight import DELTA_H
from wam_power_ros.tasks.flip.returns import WEIGHT

PERIOD = 0.005  # sampling period of the movement [s]; 0.002 s does not predict better
TAIL = 1.0  # time after the movement that is predicted too, at the tempo of the demonstration [s]
SPIN_SHARE = (
    0.6  # fraction of the pan's angular velocity at release, from tosses of tuning seeds [1]
)
RIDGE = (0.05 / 0.3) ** 2  # prior variance ratio of `TossModel`: noise of a return to w [1]


@dataclass(frozen=True, eq=False)
class Tosses:
    """Planned tosses of B policies.

    Attributes:
        tossed: Whether the pancake rises above the pan by more than Delta_h. Shape (B,).
        angle: Rotation when it falls through that height [rad]; 0 if not tossed. Shape (B,).
        apex: Highest point above the pan's height at the start [m]. Shape (B,).
        landing_error: Position of pancake minus pan at that time, x and y [m]. Shape (B, 2).
    """

    tossed: np.ndarray
    angle: np.ndarray
    apex: np.ndarray
    landing_error: np.ndarray


def plan_tosses(parameters: Parametrization, z: np.ndarray, start: np.ndarray) -> Tosses:
    """Predict the tosses of many policies.

    Args:
        parameters: Parametrization of the policies.
        z: Coordinates. Shape (B, size).
        start: Position of the pan's centre at the start, base frame [m]. Shape (3,).
    """
    position, velocity, rotation, omega = _movement(parameters, z, start)
    tempo = parameters.tempo(z)  # (B,); the movement is at the tempo of the demonstration
    velocity, omega, period = velocity * tempo, omega * tempo, PERIOD / tempo
    steps = len(position)
    normal = _normals(rotation, parameters.policy0.orientation_reference)  # (T, 3, B)
    acceleration = np.gradient(velocity, axis=0) / period
    acceleration[:, 2] += GRAVITY
    lifted = (acceleration * normal).sum(axis=1) < 0.0  # (T, B)
    released = lifted.any(axis=0)
    release = np.where(released, lifted.argmax(axis=0), steps - 1)  # (B,)
    policies = np.arange(len(release))

    t = np.maximum(np.arange(steps)[:, None] - release, 0) * period  # (T, B), since the release
    start_of_flight = position[release, :, policies].T  # (3, B)
    flying = start_of_flight + velocity[release, :, policies].T * t[:, None]  # (T, 3, B)
    flying[:, 2] -= 0.5 * GRAVITY * t**2
    above = (flying[:, 2] - position[:, 2] > DELTA_H) & (t > 0.0)
    tossed = released & above.any(axis=0)
    # The last sample above it: a pan that follows the pancake upwards crosses more than once.
    down = np.where(tossed, steps - 1 - above[::-1].argmax(axis=0), steps - 1)  # (B,)
    # Rotation in the pan, then at a fraction of the pan's angular velocity.
    cosine = (normal[0] * normal[release, :, policies].T).sum(axis=0)
    spin = np.linalg.norm(omega[release, :, policies], axis=-1)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0)) + SPIN_SHARE * spin * t[down, policies]
    miss = (flying - position)[down, :2, policies]  # (B, 2)
    rise = np.where(t > 0.0, flying[:, 2], position[:, 2]).max(axis=0) - start[2]
    return Tosses(
        tossed=tossed,
        angle=np.where(tossed, angle, 0.0),
        apex=np.where(released, rise, 0.0),
        landing_error=np.where(tossed[:, None], miss, 0.0),
    )


def planned_terms(tosses: Tosses) -> np.ndarray:
    """Terms orientation, position and altitude of Eq. 5 of B planned tosses. Shape (B, 3)."""
    miss = np.linalg.norm(tosses.landing_error, axis=1)
    folded = np.arccos(np.cos(tosses.angle)) / np.pi
    return WEIGHT * np.stack([folded, np.exp(-miss), np.maximum(tosses.apex, 0.0)], axis=1)


class TossModel:
    """A `learners.Model`: the return of the planned toss, corrected by the returns of rollouts.

    The return is modelled as sum_j (1 + w_j) term_j + w_0, with the terms of the planned toss and a
    zero-mean normal prior of w: a ridge regression, solved again after every rollout.
    """

    def __init__(self, parameters: Parametrization, start: np.ndarray) -> None:
        """Start without rollouts.

        Args:
            parameters: Parametrization of the policies.
            start: Position of the pan's centre at the start, base frame [m]. Shape (3,).
        """
        self._parameters, self._start = parameters, np.asarray(start, dtype=float)
        self._terms: list[np.ndarray] = []
        self._residuals: list[float] = []
        self._w: np.ndarray | None = None  # weights of the features, None before the first rollout

    def predict(self, z: np.ndarray) -> np.ndarray:
        """Predict the returns at z (B, size). Shape (B,)."""
        terms = self._planned(z)
        planned = terms.sum(axis=1)
        return planned if self._w is None else planned + self._features(terms) @ self._w

    def learn(self, z: np.ndarray, ret: float) -> None:
        """Fit w again, including a rollout at z (size,) with return `ret`."""
        terms = self._planned(z[np.newaxis])
        self._terms.append(self._features(terms)[0])
        self._residuals.append(ret - float(terms.sum()))
        x, y = np.stack(self._terms), np.array(self._residuals)
        self._w = np.linalg.solve(x.T @ x + RIDGE * np.eye(x.shape[1]), x.T @ y)

    def _planned(self, z: np.ndarray) -> np.ndarray:
        return planned_terms(plan_tosses(self._parameters, z, self._start))

    @staticmethod
    def _features(terms: np.ndarray) -> np.ndarray:
        return np.column_stack([terms, np.full(len(terms), 0.5)])


def _movement(
    parameters: Parametrization, z: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Integrate Eq. 1 and the same law for the rotation: x, xd, r, rd. Shape (T, 3, B) each."""
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
    """Normals of the pan at rotation vectors (T, 3, B) from `reference` (xyzw). Shape (T, 3, B)."""
    axis = rotations.matrix(reference[np.newaxis])[0][:, 2]  # (3,)
    angle = np.linalg.norm(rotation, axis=1, keepdims=True)  # (T, 1, B)
    unit = rotation / np.maximum(angle, 1e-12)
    along = (unit * axis[:, None]).sum(axis=1, keepdims=True)
    # Rodrigues: v cos + (u x v) sin + u (u.v) (1 - cos)
    turned = axis[:, None] * np.cos(angle) + unit * along * (1.0 - np.cos(angle))
    across = np.cross(unit.swapaxes(1, 2), axis).swapaxes(1, 2)  # (T, 3, B)
    return turned + across * np.sin(angle)
