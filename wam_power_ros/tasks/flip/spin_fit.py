# SPDX-License-Identifier: Apache-2.0
"""Spin fit to the frames of a flight: axis, rate and rotation of the pancake's normal.

    n(t) = exp(Omega ln(1 + d s) / d) n0,   s = t - origin

The spin Omega / (1 + d s) results from a drag proportional to its square. A freely turning disc is
a symmetric top: its normal moves on a cone about a constant axis at a constant rate, whatever its
angular velocity, so a constant spin of the normal is exact in vacuum. n0, Omega and d are fitted to
all frames by robust weighted least squares.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.tasks.flip.ballistic_fit import HUBER_THRESHOLD, Arc, release_time
from wam_power_ros.tasks.flip.frames import TILT_NOISE, Frames, pan_normal, unit

_DECAY = 0.8  # prior mean of d, the relative decay of the spin at mid-flight [1/s]
_DECAY_STD = 0.8  # prior standard deviation of d [1/s]
# Prior standard deviation of Omega along an axis [rad/s]; matters only where the frames are too far
# apart to count the turns.
_SPIN_STD = 12.0
_PRECESSION_STD = 3.0  # prior standard deviation of the spin about the disc's own normal [rad/s]
_RELEASE_STD = 0.35  # prior: normal of the pancake from the pan's at release [rad]
_SLOWING_MIN = 0.2  # smallest 1 + d s to which the spin is extrapolated [1]
_SPARSE_INTERVAL = 0.07  # time between frames from which on they may hide a turn more or less [s]
_AXIS_ANGLE_MIN = 0.2  # smallest rotation in flight that defines the spin axis [rad]
_DIFFERENCE_STEP = math.sqrt(float(np.finfo(float).eps))  # step, relative to a parameter [1]


@dataclass(frozen=True, eq=False)
class Spin:
    """Fitted motion of the pancake's normal."""

    origin: float  # time at which s = 0 [s]
    release: float  # time of release from the pan [s]
    normal0: np.ndarray  # unit vector that the first two parameters rotate to n0, shape (3,)
    # Rotation of normal0 about its two tangents [rad], Omega [rad/s], d [1/s], shape (6,)
    theta: np.ndarray

    def normal(self, t: np.ndarray) -> np.ndarray:
        """Normal at times t (m,) [s], base frame. Shape (m, 3)."""
        return _spun(self.theta, np.atleast_1d(t) - self.origin, self.normal0)

    def turned(self, start: np.ndarray, t: float) -> float:
        """Rotation of the normal from rest, at `start` (3,), to a time after the release [rad].

        In the plane of `start` that is normal to the spin axis, more than a turn if it was more.
        What leans out of that plane, as of a pan that is rolled to the side, does not count.
        """
        omega = self.theta[2:5]
        speed = float(np.linalg.norm(omega))
        if speed * (t - self.release) < _AXIS_ANGLE_MIN:
            return angle_between(start, self.normal(np.array([t]))[0])
        path = self.normal(np.linspace(self.release, t, 200))
        sine = path @ unit(np.cross(omega / speed, start))
        return abs(float(np.unwrap(np.arctan2(sine, path @ start))[-1]))


def fit_spin(frames: Frames, arc: Arc, pan: EndEffectorPath) -> Spin:
    """Fit a spin to the normals of the arc's inlier frames by robust weighted least squares.

    The normal of the pan at the release is roughly that of the pancake and serves as a prior.
    """
    normals = frames.normal[arc.used]
    t, origin = arc.t, arc.origin
    release = release_time(frames, arc, pan)
    release_normal = pan_normal(pan, np.array([release]))[0]
    problem = _SpinProblem(
        s=np.append(t, release) - origin,
        targets=np.vstack([normals, release_normal]),
        noise=np.append(np.full(len(t), TILT_NOISE), _RELEASE_STD)[:, None],
        normal0=normals[int(np.argmin(np.abs(t - origin)))],
    )
    fits = []
    for omega in _spin_guesses(np.append(release, t), np.vstack([release_normal, normals])):
        rotation = _rotation_guess(problem.normal0, omega, t, origin, normals)
        fits.append(
            scipy.optimize.least_squares(
                problem.residuals,
                np.concatenate([rotation, omega, [_DECAY]]),
                problem.jacobian,
                loss="huber",
                f_scale=HUBER_THRESHOLD,
                max_nfev=60,
            )
        )
    best = min(fits, key=lambda fitted: fitted.cost)
    return Spin(origin, release, problem.normal0, best.x)


@dataclass(frozen=True, eq=False)
class _SpinProblem:
    """Least-squares problem of the spin."""

    s: np.ndarray  # times of the targets since the origin [s], shape (m,)
    targets: np.ndarray  # measured normals, and that of the pan at the release, shape (m, 3)
    noise: np.ndarray  # standard deviation of each target along an axis [1], shape (m, 1)
    normal0: np.ndarray  # as in `Spin`, shape (3,)

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        """Residuals at theta (6,), in standard deviations. Shape (n,)."""
        return self._residuals_of_many(theta[np.newaxis])[0]

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        """Derivatives of the residuals by forward differences. Shape (n, 6)."""
        steps = _DIFFERENCE_STEP * np.maximum(1.0, np.abs(theta))
        rows = self._residuals_of_many(np.vstack([theta, theta + np.diag(steps)]))
        return (rows[1:] - rows[0]).T / steps

    def _residuals_of_many(self, thetas: np.ndarray) -> np.ndarray:  # (B, 6) -> (B, n)
        modelled = _spun(thetas, np.append(self.s, 0.0), self.normal0)  # (B, m + 1, 3)
        along = np.sum(thetas[:, 2:5] * modelled[:, -1], axis=1)
        priors = (
            thetas[:, 2:5] / _SPIN_STD,
            (thetas[:, 5:] - _DECAY) / _DECAY_STD,
            along[:, None] / _PRECESSION_STD,
        )
        errors = (modelled[:, :-1] - self.targets) / self.noise
        return np.concatenate([errors.reshape(len(thetas), -1), *priors], axis=1)


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between unit vectors [rad]."""
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))


def _spun(theta: np.ndarray, s: np.ndarray, normal0: np.ndarray) -> np.ndarray:
    """Normals n(t) for parameters theta (..., 6), as in `Spin`. Shape (..., m, 3)."""
    start = rotations.exp(theta[..., :2] @ np.array(_tangents(normal0))) @ normal0
    decay = theta[..., 5:] * s  # (..., m)
    small = np.abs(decay) < 1e-6
    safe = np.where(small, 1.0, np.maximum(decay, _SLOWING_MIN - 1.0))
    elapsed = s * np.where(small, 1.0 - 0.5 * decay, np.log1p(safe) / safe)
    turns = rotations.exp(elapsed[..., None] * theta[..., None, 2:5])  # (..., m, 3, 3)
    return (turns @ start[..., None, :, None])[..., 0]


def _rotation_guess(
    normal0: np.ndarray, omega: np.ndarray, t: np.ndarray, origin: float, normals: np.ndarray
) -> np.ndarray:
    """Initial guess of the rotation of normal0, from the frame nearest the origin. Shape (2,)."""
    nearest = int(np.argmin(np.abs(t - origin)))
    at_origin = rotations.exp(omega * (origin - t[nearest])) @ normals[nearest]
    turn = np.cross(normal0, at_origin)
    return np.array(_tangents(normal0)) @ turn


def _spin_guesses(t: np.ndarray, normals: np.ndarray) -> list[np.ndarray]:
    """Initial guesses of Omega [rad/s] from successive normals; the first is at the release."""
    turn = np.cross(normals[:-1], normals[1:])
    sine = np.linalg.norm(turn, axis=1)
    angle = np.arctan2(sine, np.sum(normals[:-1] * normals[1:], axis=1))
    gaps = np.maximum(np.diff(t), 1e-6)
    rates = turn / np.maximum(sine, 1e-12)[:, None] * (angle / gaps)[:, None]
    shortest = float(gaps[1:].min())
    close = np.append(False, gaps[1:] < 1.5 * shortest)
    omega = np.median(rates[close], axis=0)
    speed = float(np.linalg.norm(omega))
    if shortest < _SPARSE_INTERVAL or speed < 1e-6:
        return [omega]
    # Between frames this far apart, one more turn in either direction is possible.
    axis = omega / speed
    return [omega, omega - 2.0 * math.pi / shortest * axis, omega + 2.0 * math.pi / shortest * axis]


def _tangents(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors perpendicular to a unit vector and to each other."""
    helper = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = unit(np.cross(normal, helper))
    return first, np.cross(normal, first)
