# SPDX-License-Identifier: Apache-2.0
"""Rotations as vectors, matrices and unit quaternions (xyzw), one or many at a time.

A rotation vector `r` [rad] points along the axis and its length is the angle; `exp(r)` is its
matrix. A single rotation is computed with plain floats, which is fast enough for the 500 Hz loop;
arrays of any leading shape are vectorised. Shapes are (..., 3) for vectors, (..., 3, 3) for
matrices and (..., 4) for quaternions. No argument is modified.
"""

import itertools
import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from wam_power_ros import compiled

T = TypeVar("T", float, np.ndarray)
_TINY = 1e-8  # angle below which a second-order series is exact to rounding [rad]


def exp(rotation_vector: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad], by Rodrigues' formula."""
    r = np.asarray(rotation_vector, dtype=float)
    x, y, z = r[..., 0], r[..., 1], r[..., 2]
    angle2 = x * x + y * y + z * z
    angle = np.sqrt(angle2)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    sine = np.where(small, 1.0 - angle2 / 6.0, np.sin(safe) / safe)  # sin(a)/a
    versine = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    matrix = np.empty((*r.shape[:-1], 3, 3))
    matrix[..., 0, 0] = 1.0 - versine * (y * y + z * z)
    matrix[..., 1, 1] = 1.0 - versine * (x * x + z * z)
    matrix[..., 2, 2] = 1.0 - versine * (x * x + y * y)
    matrix[..., 0, 1] = versine * x * y - sine * z
    matrix[..., 1, 0] = versine * x * y + sine * z
    matrix[..., 0, 2] = versine * x * z + sine * y
    matrix[..., 2, 0] = versine * x * z - sine * y
    matrix[..., 1, 2] = versine * y * z - sine * x
    matrix[..., 2, 1] = versine * y * z + sine * x
    return matrix


def log_of_one(matrix: np.ndarray) -> tuple[float, float, float]:
    """Rotation vector [rad] of one rotation matrix (3, 3) as plain floats, see `log`."""
    if compiled.kernel is not None:
        return compiled.kernel.rotation_vector(matrix, _TINY)
    return _vector_of_one(*_quat_of_one(*matrix.ravel().tolist()))


def log(matrix: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad] of rotation matrices (..., 3, 3).

    Their length is at most pi; they are accurate near 0 and pi.
    """
    return rotation_vector(quat_xyzw(matrix))


def quat_xyzw(matrix: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4), with w >= 0, of rotation matrices (..., 3, 3) by Shepperd's method."""
    matrix = np.asarray(matrix, dtype=float)
    if matrix.ndim == 2:
        return np.array(_quat_of_one(*matrix.ravel().tolist()))
    flat = matrix.reshape(-1, 9)
    quats = np.array([_quat_of_one(*row) for row in flat.tolist()])
    return quats.reshape((*matrix.shape[:-2], 4))


def _quat_of_one(
    m00: float, m01: float, m02: float,
    m10: float, m11: float, m12: float,
    m20: float, m21: float, m22: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    trace = m00 + m11 + m22
    if trace >= max(m00, m11, m22):
        x, y, z, w = m21 - m12, m02 - m20, m10 - m01, 1.0 + trace
    elif m00 >= m11 and m00 >= m22:
        x, y, z, w = 1.0 + 2.0 * m00 - trace, m01 + m10, m02 + m20, m21 - m12
    elif m11 >= m22:
        x, y, z, w = m01 + m10, 1.0 + 2.0 * m11 - trace, m12 + m21, m02 - m20
    else:
        x, y, z, w = m02 + m20, m12 + m21, 1.0 + 2.0 * m22 - trace, m10 - m01
    scale = math.copysign(1.0 / math.sqrt(x * x + y * y + z * z + w * w), w)
    return x * scale, y * scale, z * scale, w * scale


def matrix(quat_xyzw: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) of any length.

    Raises:
        ValueError: If a quaternion is not finite or has zero length.
    """
    x, y, z, w = np.moveaxis(normalised(quat_xyzw), -1, 0)
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def normalised(quat_xyzw: np.ndarray) -> np.ndarray:
    """Scale quaternions (..., 4) to unit length. Shape (..., 4).

    Raises:
        ValueError: If a quaternion is not finite or has zero length.
    """
    quat = np.asarray(quat_xyzw, dtype=float)
    if quat.ndim == 1:
        length = math.sqrt(sum([value * value for value in quat.tolist()]))
        if _TINY < length < math.inf:
            return quat / length
    else:
        lengths = np.sqrt(np.sum(quat * quat, axis=-1, keepdims=True))
        if np.all(np.isfinite(lengths) & (lengths > _TINY)):
            return quat / lengths
    raise ValueError(f"quaternion {quat} has no direction; its length must be above {_TINY}")


def rotation_vector(quat_xyzw: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad], of length at most pi, of quaternions (..., 4)."""
    quat = np.asarray(quat_xyzw, dtype=float)
    if quat.ndim == 1:
        return np.array(_vector_of_one(*quat.tolist()))
    vector, w = quat[..., :3], quat[..., 3]
    sine = np.sqrt(np.sum(vector * vector, axis=-1))
    small = sine < _TINY
    angle = 2.0 * np.arctan2(np.copysign(sine, w), np.abs(w))
    scale = np.where(small, np.copysign(2.0, w), angle / np.where(small, 1.0, sine))
    return vector * scale[..., None]


def _vector_of_one(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    sine = math.sqrt(x * x + y * y + z * z)
    if sine < _TINY:
        scale = 2.0 if w >= 0.0 else -2.0
    else:
        scale = 2.0 * math.atan2(math.copysign(sine, w), abs(w)) / sine
    return x * scale, y * scale, z * scale


def quat_of_vector(rotation_vector: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4) of rotation vectors (..., 3) [rad]."""
    r = np.asarray(rotation_vector, dtype=float)
    half = 0.5 * np.sqrt(np.sum(r * r, axis=-1))
    scale = 0.5 * np.sinc(half / np.pi)  # sin(half) / (2 half)
    return np.concatenate([r * scale[..., None], np.cos(half)[..., None]], axis=-1)


def multiply(a_xyzw: np.ndarray, b_xyzw: np.ndarray) -> np.ndarray:
    """Quaternion products a b (..., 4): the rotation b followed by the rotation a."""
    a, b = np.asarray(a_xyzw, dtype=float), np.asarray(b_xyzw, dtype=float)
    if a.ndim == b.ndim == 1:
        return np.array(_product(a.tolist(), b.tolist()))
    return np.stack(_product([*np.moveaxis(a, -1, 0)], [*np.moveaxis(b, -1, 0)]), axis=-1)


def _product(a: Sequence[T], b: Sequence[T]) -> tuple[T, T, T, T]:
    """Components of the quaternion product: four floats each, or four arrays."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def continuous(rotation_vectors: np.ndarray) -> np.ndarray:
    """Rotation vectors (N, 3) [rad] unwrapped, so that they do not jump where the angle passes pi.

    They are in temporal order, less than half a turn apart. To each one the number of whole turns
    about its axis is added that brings it closest to its predecessor.
    """
    vectors = np.array(rotation_vectors, dtype=float)
    for previous, vector in itertools.pairwise(vectors):
        angle = math.sqrt(vector.dot(vector))
        if angle > _TINY:
            axis = vector / angle
        else:
            length = math.sqrt(previous.dot(previous))
            axis = previous / length if length > _TINY else np.zeros(3)
        turns = round((previous.dot(axis) - vector.dot(axis)) / (2.0 * math.pi))
        vector += 2.0 * math.pi * turns * axis
    return vectors


def interpolate(t: np.ndarray, times: np.ndarray, quat_xyzw: np.ndarray) -> np.ndarray:
    """Unit quaternions (M, 4) at times t (M,) [s], along the shortest arc between samples.

    The samples (N, 4) have strictly increasing times (N,) [s], outside which it is constant.
    """
    t = np.clip(np.asarray(t, dtype=float), times[0], times[-1])
    if len(times) == 1:
        return np.repeat(quat_xyzw, len(t), axis=0)
    right = np.clip(np.searchsorted(times, t, side="right"), 1, len(times) - 1)
    left = right - 1
    share = (t - times[left]) / (times[right] - times[left])
    inverse = quat_xyzw[left] * np.array([-1.0, -1.0, -1.0, 1.0])
    step = rotation_vector(multiply(quat_xyzw[right], inverse))
    return multiply(quat_of_vector(step * share[:, None]), quat_xyzw[left])
