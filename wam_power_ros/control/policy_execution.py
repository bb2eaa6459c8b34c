# SPDX-License-Identifier: Apache-2.0
"""A rollout under way: the acceleration its policy wants in every state, and the path so far."""

import math

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.control.arm import Motion
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.tracking_error import TrackingLost
from wam_power_ros.learning import dmp
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import EndEffectorPath

# A rotation vector's spring pulls about the wrong axis the more, the longer the vector: at 2.4 rad
# the orientation becomes unstable.
TURN_MAX = 2.0


class Execution:
    """One rollout; it begins with the first state whose stamp it is told.

    Attributes:
        id: Of the policy.
        start_ns: Stamp of the first state, None before it [ns].
        count: Samples of the path so far.

    Args:
        policy: To execute.
        tables: Of the policy, on the grid of the control loop.
        settings: Of the controller.
    """

    def __init__(self, policy: Policy, tables: dmp.Tables, settings: ControllerSettings) -> None:
        self.id = policy.id
        self.start_ns: int | None = None
        self.count = 0
        self._tables = tables
        self._reference = rotations.matrix(policy.orientation_reference).T
        self._period_ns = round(settings.period * 1e9)
        # ticks: after which it is over, from one sample to the next, of the next sample
        self._end = round((policy.basis.duration + settings.settle_time) / settings.period)
        self._every = round(settings.path_period / settings.period)
        self._next_sample = 0
        size = self._end // self._every + 2
        self._t = np.empty(size)
        self._position, self._quat_xyzw = np.empty((size, 3)), np.empty((size, 4))

    def tick(self, stamp_ns: int) -> int | None:
        """Control periods since the first state, None when the rollout is over."""
        if self.start_ns is None:
            self.start_ns = stamp_ns
        k = (stamp_ns - self.start_ns + self._period_ns // 2) // self._period_ns
        return None if k > self._end else k

    def acceleration(self, k: int, motion: Motion) -> np.ndarray:
        """Eq. 1 in closed loop on the measured state, and the orientation that belongs to it.

        Args:
            k: Tick.
            motion: Kinematics of the state.

        Returns:
            Linear [m/s^2] and angular [rad/s^2]. Shape (6,).

        Raises:
            TrackingLost: The tool is turned too far from the reference.
        """
        if k >= self._next_sample:
            self.sample(k, motion)
        vector = rotations.log(motion.rotation.dot(self._reference)).tolist()
        if math.hypot(*vector) > TURN_MAX:
            raise TrackingLost(f"the tool is turned by more than {TURN_MAX} rad from the reference")
        return dmp.acceleration(self._tables, k, motion.position, vector, motion.twist.tolist())

    def sample(self, k: int, motion: Motion) -> None:
        """Note where the tool is at a tick."""
        row = self.count
        self._t[row] = k * self._period_ns * 1e-9  # the float that a stamp comes back as
        self._position[row] = motion.position
        self._quat_xyzw[row] = rotations.quat_xyzw(motion.rotation)
        self.count += 1
        self._next_sample = (k // self._every + 1) * self._every

    def path(self) -> EndEffectorPath:
        """The path so far."""
        n = self.count
        return EndEffectorPath(self.id, self._t[:n], self._position[:n], self._quat_xyzw[:n])
