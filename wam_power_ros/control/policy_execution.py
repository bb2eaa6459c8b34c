# SPDX-License-Identifier: Apache-2.0
"""Execution of a policy on the arm: one rollout and its path."""

import math
from collections.abc import Callable

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.control import torque_law
from wam_power_ros.control.arm import Arm, Dynamics, Motion
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.joint_control import TrackingLost
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.learning import dmp
from wam_power_ros.learning.dmp import TabulatedPolicy
from wam_power_ros.learning.rollout import EndEffectorPath

Law = Callable[[Motion, Dynamics, np.ndarray], np.ndarray]
PATH_PERIOD = 0.01  # [s] between two samples of the end-effector path
# The longer the rotation vector, the more its spring pulls about a wrong axis: at 2.4 rad the
# orientation becomes unstable.
ROTATION_ERROR_MAX = 2.0  # [rad]


class Execution:
    """One rollout; it begins with the first state.

    Attributes:
        start_ns: Stamp of the first state [ns], None before it.
        under_way: False from `end` on.
        complete: Whether the movement has run to its end.
        stopped_in: Name of the guarded region that has ended it, "" for none.
        of_model: Whether the states are those of a model, so that `record` alone gives the path.
    """

    def __init__(self, policy: TabulatedPolicy, arm: Arm, settings: ControllerSettings) -> None:
        self.id = policy.id
        self.start_ns: int | None = None
        self.under_way, self.complete = True, False
        self.stopped_in, self.of_model = "", False
        self._path: EndEffectorPath | None = None
        self._arm, self._policy = arm, policy
        self._law: Law = getattr(torque_law, settings.law)
        self._reference = rotations.matrix(policy.orientation_reference).T
        self._region = settings.region
        self._period_ns = round(settings.period * 1e9)
        self._last_tick = round((policy.duration + settings.settle_time) / settings.period)
        self._sample_ticks = max(1, round(PATH_PERIOD / settings.period))
        self._next_sample = 0  # tick
        self._count = 0  # samples of the path so far
        # Three more: the first sample, the last, and one in the region.
        size = self._last_tick // self._sample_ticks + 3
        self._t = np.empty(size)
        self._position, self._quat_xyzw = np.empty((size, 3)), np.empty((size, 4))

    def torque(self, state: JointState, motion: Motion) -> np.ndarray | None:
        """Joint torques for one state, None when the rollout is over.

        Evaluates Eq. 1 and the orientation law in closed loop on the measured state.

        Returns:
            [N m]. Shape (n,).

        Raises:
            TrackingLost: The tool's orientation is too far from its reference.
        """
        if self.start_ns is None:
            self.start_ns = state.stamp_ns
        k = (state.stamp_ns - self.start_ns + self._period_ns // 2) // self._period_ns
        if k > self._last_tick:
            self.complete = True
            return None
        if self._region is not None and self._region.contains(motion.position):
            self.stopped_in = self._region.name
            if not self.of_model:
                self._sample(k, motion)
            return None
        if not self.of_model and k >= self._next_sample:
            self._sample(k, motion)
        vector = rotations.log_of_one(motion.rotation.dot(self._reference))
        if (angle := math.hypot(*vector)) > ROTATION_ERROR_MAX:
            text = f"the tool is rotated by {angle:.2f} rad from its reference"
            raise TrackingLost(f"{text}, limit {ROTATION_ERROR_MAX}")
        twist = motion.twist.tolist()
        acceleration = dmp.acceleration(self._policy, k, motion.position, vector, twist)
        dynamics = self._arm.dynamics(state.q, state.qd, state.bias)
        return self._law(motion, dynamics, acceleration)

    def record(self, stamp_ns: int, motion: Motion) -> None:
        """Add the motion of a reported state to the path, if it is due."""
        if self.start_ns is None or not self.under_way:
            return
        k = (stamp_ns - self.start_ns + self._period_ns // 2) // self._period_ns
        if k >= self._next_sample and self._count < len(self._t):
            self._sample(max(k, 0), motion)

    def end(self, last: JointState) -> None:
        """Keep the path so far, or that of the last state without one; has an effect once."""
        if not self.under_way:
            return
        self.under_way = False
        if not self._count:
            self._sample(0, self._arm.motion(last.q, last.qd))
        n = self._count
        self._path = EndEffectorPath(self.id, self._t[:n], self._position[:n], self._quat_xyzw[:n])

    def take_path(self) -> EndEffectorPath | None:
        """Return the path after the end, once; then None."""
        path, self._path = self._path, None
        return path

    def _sample(self, k: int, motion: Motion) -> None:
        """Add the tool's pose at a tick to the path, unless the path has one at this tick."""
        row, t = self._count, k * self._period_ns * 1e-9  # the same float as from a stamp in [ns]
        if row and t <= self._t[row - 1]:
            return
        self._t[row] = t
        self._position[row] = motion.position
        self._quat_xyzw[row] = rotations.quat_xyzw(motion.rotation)
        self._count += 1
        self._next_sample = (k // self._sample_ticks + 1) * self._sample_ticks
