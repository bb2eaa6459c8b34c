# SPDX-License-Identifier: Apache-2.0
"""Ground truth of a rollout: log of the simulated states, and peak values of the arm.

It is logged and displayed only; no part of the system learns from it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np

from hardware_sim.motors import DirectDrives, Motors
from hardware_sim.settings import WorldSettings

TOOL_SITE = "tool origin"  # site of the model at the origin of the tool
LOG_TIME = 10.0  # [s] from the release on that is logged

Truth = dict[str, Any]  # JSON data, as published and written to the session log


class Snapshot(NamedTuple):
    """Body and tool at one instant."""

    body: np.ndarray  # (7,) position [m] and quaternion wxyz of the tracked body; (0,) without one
    position: np.ndarray  # (3,) of the tool [m]
    rotation: np.ndarray  # (3, 3) of the tool


def rotation_of(body: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of a pose (7,): position and quaternion wxyz."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, body[3:])
    return matrix.reshape(3, 3)


class RolloutLog:
    """State after each tick since the release, one row per tick, for `LOG_TIME` at most.

    The model has a site at every guarded point and at the tool; `body` are the columns of the
    tracked body in qpos and qvel, empty without one.
    """

    start: Snapshot  # at the release

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        settings: WorldSettings,
        body: tuple[slice, slice],
    ) -> None:
        self.period, full = settings.period, settings.ticks(LOG_TIME)
        self._data, self._n = data, len(settings.model_joint_names)
        names = [*(point.name for point in settings.guarded), TOOL_SITE]
        self._points = [model.site(name).id for name in names]
        self._body = body
        self._qpos = np.empty((full, model.nq))
        self._qvel = np.empty((full, model.nv))
        self._tau = np.empty((full, self._n))
        self._sites = np.empty((full, *data.site_xpos.shape))
        self.rows = 0
        self._saturated = 0

    def restart(self, start: Snapshot) -> None:
        """Clear all rows; `start` is not copied."""
        self.start, self.rows, self._saturated = start, 0, 0

    def record(self, saturated: bool) -> None:
        """Add a row unless the log is full; `saturated`: a motor could not give its torque."""
        self._saturated += saturated
        row, data = self.rows, self._data
        if row == len(self._qpos):
            return
        self._qpos[row] = data.qpos
        self._qvel[row] = data.qvel
        self._tau[row] = data.qfrc_applied[: self._n]
        self._sites[row] = data.site_xpos
        self.rows = row + 1

    @property
    def positions(self) -> np.ndarray:
        """Joint positions of arm and bodies. Shape (rows, nq)."""
        return self._qpos[: self.rows]

    @property
    def body(self) -> np.ndarray:
        """Position [m] and quaternion wxyz of the tracked body. Shape (rows, 7)."""
        return self.positions[:, self._body[0]]

    @property
    def body_twist(self) -> np.ndarray:
        """Velocity [m/s], and angular velocity in the body's frame [rad/s]. Shape (rows, 6)."""
        return self._qvel[: self.rows, self._body[1]]

    @property
    def tool(self) -> np.ndarray:
        """Position of the tool [m]. Shape (rows, 3)."""
        return self._sites[: self.rows, self._points[-1]]

    def arm_truth(self, motors: Motors | DirectDrives) -> Truth:
        """Peak values of an arm driven by `motors` since the release.

        * peak_qd: Peak speed of each joint [rad/s].
        * peak_tau: Peak torque of the motors at each joint [N m].
        * peak_elbow_speed: Peak speed of the first guarded point [m/s].
        * peak_forearm_speed: Peak speed of the last guarded point [m/s].
        * peak_pan_speed: Peak speed of the tool [m/s].
        * beyond_no_load: A motor exceeded its no-load speed at the bus voltage.
        * saturated: Share of ticks in which a motor could not give the commanded torque.
        """
        rows = self.rows
        speeds = np.zeros(len(self._points))
        if rows > 1:
            steps = np.diff(self._sites[:rows, self._points], axis=0)
            speeds = np.linalg.norm(steps, axis=2).max(axis=0) / self.period
        qd = self._qvel[:rows, : self._n]
        motor_speeds = np.abs(qd @ motors.motor_of_joint.T).max(axis=0, initial=0.0)
        return {
            "peak_qd": np.abs(qd).max(axis=0, initial=0.0).tolist(),
            "peak_tau": np.abs(self._tau[:rows]).max(axis=0, initial=0.0).tolist(),
            "peak_elbow_speed": float(speeds[0]),
            "peak_forearm_speed": float(speeds[-2]),
            "peak_pan_speed": float(speeds[-1]),
            "beyond_no_load": bool((motor_speeds > motors.motor_no_load_speed).any()),
            "saturated": self._saturated / max(rows, 1),
        }
