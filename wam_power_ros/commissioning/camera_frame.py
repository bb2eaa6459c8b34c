# SPDX-License-Identifier: Apache-2.0
"""Frame of the cameras, pose of a body on the tool, and zeros of the joints, from postures at rest.

The body at posture i is seen at C_i = Y F(q_i - z) X: Y is the pose of the base in the cameras'
frame, F the forward kinematics, X the pose of the body in the tool, z the zeros of the joints. All
are found together: an arm whose zeros are a degree off believes its tool centimetres away from
where the cameras see it, whatever the frame. The zero of the first joint cannot be told from the
yaw of the base: it counts as 0. That of the last joint cannot be told from the roll of the body
either, unless the body is known to lie flat in the tool.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.control.arm import Arm

POSITION_NOISE = 5e-4  # [m] of a pose averaged at rest, per axis
ROTATION_NOISE = np.deg2rad(0.2)  # [rad] per axis
FLATNESS = np.deg2rad(0.3)  # [rad] between the normals of tool and of a body that lies flat in it
ZERO_SPREAD = np.deg2rad(2.0)  # [rad] expected of a zero before anything is measured
OUTLIER = 5.0  # multiple of the residual of all postures from which one is rejected
POSTURES_MIN = 10  # accepted postures without which nothing is said
SPREAD_MIN = np.deg2rad(15.0)  # [rad] smallest range of the tool's orientation over the postures
RESIDUAL_MAX = 10.0  # multiple of the noise: a mirrored axis gives hundreds


@dataclass(frozen=True, eq=False)
class Pose:
    """Position [m], shape (3,), and rotation matrix, shape (3, 3)."""

    position: np.ndarray
    rotation: np.ndarray

    def inverse(self) -> Pose:
        """The pose of the other frame in this one."""
        turned = self.rotation.T
        return Pose(-turned @ self.position, turned)


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """Result of `calibrate`.

    Attributes:
        world_to_base: Pose of the cameras' frame in the frame of the base.
        body_in_tool: Pose of the body in the frame of the tool.
        zeros: Reported minus true position of each joint, 0 for the first [rad]; 0 for the last,
            too, unless the body lies flat. Shape (n,).
        zeros_sd: Standard deviation of each, from the residual [rad]. Shape (n,).
        position_rms: Root mean square of the residual, of accepted postures [m].
        rotation_rms: The same [rad].
        rejected: Numbers of the postures that do not agree with the others, from 0.
        upright: Angle between the vertical axes of base and cameras [rad].
    """

    world_to_base: Pose
    body_in_tool: Pose
    zeros: np.ndarray
    zeros_sd: np.ndarray
    position_rms: float
    rotation_rms: float
    rejected: tuple[int, ...]
    upright: float


def calibrate(
    arm: Arm, q: np.ndarray, position: np.ndarray, rotation: np.ndarray, flat: bool = False
) -> CameraFrame:
    """Find the cameras' frame, the pose of the body on the tool, and the zeros.

    Args:
        arm: Arm as its URDF describes it, without corrections; its buffers are used.
        q: Reported positions of the joints at rest [rad]. Shape (N, n).
        position: Position of the body in the cameras' frame [m]. Shape (N, 3).
        rotation: Its orientation. Shape (N, 3, 3).
        flat: Whether the body lies flat in the tool: their z axes are parallel.

    Raises:
        ValueError: The postures are too few or too much alike, or most of them do not agree: the
            message says with what and what may be the cause.
    """
    if len(q) < POSTURES_MIN:
        raise ValueError(f"{len(q)} postures, at least {POSTURES_MIN} are needed")
    tools = [Pose(*arm.tool_pose(each)) for each in q]
    spread = max(
        float(np.linalg.norm(rotations.log(tools[0].rotation.T @ tool.rotation))) for tool in tools
    )
    if spread < SPREAD_MIN:
        shown, least = np.rad2deg([spread, SPREAD_MIN])
        text = f"the postures turn the tool by at most {shown:.0f} degrees"
        raise ValueError(f"{text}, at least {least:.0f} are needed")
    accepted = np.arange(len(q))
    while True:
        solution = _solve(arm, q[accepted], position[accepted], rotation[accepted], flat)
        sizes = solution.sizes
        typical = max(float(np.median(sizes)), 1.0)
        worst = int(sizes.argmax())
        if sizes[worst] <= OUTLIER * typical:
            break
        accepted = np.delete(accepted, worst)
        if len(accepted) < POSTURES_MIN:
            text = f"only {len(accepted)} of {len(q)} postures agree, {POSTURES_MIN} are needed"
            raise ValueError(f"{text}: a marker moves on the tool, or is often hidden")
    if typical > RESIDUAL_MAX:
        text = f"the postures disagree, the residual is {typical:.0f} times the noise, at most "
        text += f"{RESIDUAL_MAX:.0f} is allowed: "
        flip = np.diag([-1.0, 1.0, 1.0])
        seen = position[accepted] @ flip, flip @ rotation[accepted] @ flip
        other = _solve(arm, q[accepted], *seen, flat=False)
        if other.sizes.max() < OUTLIER * RESIDUAL_MAX:
            raise ValueError(f"{text}the cameras' axes are mirrored (left-handed)")
        raise ValueError(
            f"{text}the cameras were knocked, the body moved in the tool (another lay on it, "
            "its markers are loose), or the joints have another order or sign"
        )
    return _result(solution, len(q), accepted)


class _Fit(NamedTuple):
    """Y, X and zeros (n,), the errors of each posture in multiples of the noise, derivatives."""

    base: Pose
    body: Pose
    zeros: np.ndarray
    rows: np.ndarray  # (N, 6)
    jacobian: np.ndarray

    @property
    def sizes(self) -> np.ndarray:
        """Largest error of each posture. Shape (N,)."""
        return np.abs(self.rows).max(axis=1)


def _result(found: _Fit, count: int, accepted: np.ndarray) -> CameraFrame:
    rows, jacobian = found.rows, found.jacobian
    scale = max(1.0, float(np.sqrt(np.mean(rows**2))))  # geometry errors count as noise
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    deviations = scale * np.sqrt(covariance.diagonal())[12:]
    zeros_sd = np.zeros(len(found.zeros))
    zeros_sd[1 : 1 + len(deviations)] = deviations
    up = found.base.rotation[:, 2]
    return CameraFrame(
        world_to_base=found.base.inverse(),
        body_in_tool=found.body,
        zeros=found.zeros,
        zeros_sd=zeros_sd,
        position_rms=POSITION_NOISE * float(np.sqrt(np.mean(rows[:, :3] ** 2))),
        rotation_rms=float(ROTATION_NOISE) * float(np.sqrt(np.mean(rows[:, 3:] ** 2))),
        rejected=tuple(sorted(set(range(count)) - set(accepted.tolist()))),
        upright=float(np.arctan2(np.hypot(up[0], up[1]), up[2])),
    )


def _solve(arm: Arm, q: np.ndarray, position: np.ndarray, rotation: np.ndarray, flat: bool) -> _Fit:
    """Least squares on Y, X and the zeros, from the closed-form solution without zeros."""
    # Imported here: the import is slow, and every command of `wam-power` would wait for it.
    from scipy.optimize import least_squares

    starts = closed_form([Pose(*arm.tool_pose(each)) for each in q], position, rotation)

    def parts(x: np.ndarray) -> tuple[Pose, Pose, np.ndarray]:
        """Poses and zeros (n,) of the unknown numbers, which are relative to the start."""
        zeros = np.zeros(arm.n)
        zeros[1 : len(x) - 11] = x[12:]
        base, body = (
            Pose(start.position + part[:3], rotations.exp(part[3:]) @ start.rotation)
            for start, part in zip(starts, (x[:6], x[6:12]), strict=True)
        )
        return base, body, zeros

    def residuals(x: np.ndarray) -> np.ndarray:
        turned, mounted, zeros = parts(x)
        rows = []
        for posture, seen, turn in zip(q, position, rotation, strict=True):
            place, axes = arm.tool_pose(posture - zeros)
            expected = turned.rotation @ (place + axes @ mounted.position) + turned.position
            axes = turned.rotation @ axes @ mounted.rotation
            rows.append((expected - seen) / POSITION_NOISE)
            rows.append(rotations.log(axes.T @ turn) / ROTATION_NOISE)
        if flat:
            rows.append(mounted.rotation[:2, 2] / FLATNESS)
        return np.concatenate([*rows, x[12:] / ZERO_SPREAD])

    unknown = 12 + arm.n - 1 - (not flat)
    start = least_squares(residuals, np.zeros(unknown), x_scale="jac").x
    found = least_squares(residuals, start, loss="huber", x_scale="jac")
    rows = residuals(found.x)[: 6 * len(q)].reshape(-1, 6)
    return _Fit(*parts(found.x), rows, found.jac)


def closed_form(tools: list[Pose], position: np.ndarray, rotation: np.ndarray) -> tuple[Pose, Pose]:
    """Y and X of C_i = Y F_i X by two linear least squares: rotations, then positions.

    Args:
        tools: F_i, poses of the tool in the base.
        position: Positions of the body in the cameras' frame [m]. Shape (N, 3).
        rotation: Its orientations. Shape (N, 3, 3).
    """
    eye = np.eye(3)
    rows = [  # of Y^T C_i - F_i X = 0, columns stacked
        np.hstack([np.kron(seen.T, eye), -np.kron(eye, tool.rotation)])
        for tool, seen in zip(tools, rotation, strict=True)
    ]
    null = np.linalg.svd(np.vstack(rows))[2][-1]
    turned, mounted = (null[k : k + 9].reshape(3, 3, order="F") for k in (0, 9))
    sign = np.sign(np.linalg.det(mounted))  # the null vector has any sign
    base, body = (_nearest_rotation(sign * matrix) for matrix in (turned.T, mounted))
    matrix = [np.hstack([base @ tool.rotation, eye]) for tool in tools]
    right = [seen - base @ tool.position for tool, seen in zip(tools, position, strict=True)]
    found = np.linalg.lstsq(np.vstack(matrix), np.concatenate(right), rcond=None)[0]
    return Pose(found[3:], base), Pose(found[:3], body)


def _nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
