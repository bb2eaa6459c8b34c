# SPDX-License-Identifier: Apache-2.0
"""Choices of the torque controller."""

import math
from dataclasses import dataclass, field

from wam_power_ros.control.safety import Limits
from wam_power_ros.control.torque_law import TorqueLaw


@dataclass(frozen=True)
class ControllerSettings:
    """Choices of the controller; the defaults suit the Barrett WAM with a pan.

    Attributes:
        period: Of the joint states [s].
        driver_compensates_gravity: The driver adds g(q) itself; it is left out of what is sent.
        hold_to_run: Teaching, replay and the first run of a policy need `Controller.enabled`.
        law: From the tool's acceleration to joint torques.
        limits: None for those of the arm with the defaults of `safety.Limits`.
        hold_bandwidth: Natural frequency of the joints in hold, move and replay [rad/s].
            With a delay of 8 ms, 30 is the most that survives a push of 40 N.
        hold_damping_ratio: Of the same.
        friction_share: Of the joints' friction that is fed forward where the reference moves.
        move_speed: Peak joint speed of a move to a start [rad/s].
        brake_time: In which a motion comes to rest when hold begins [s].
        settle_time: Rollout with its last row after the end of the movement [s].
        path_period: Of the end-effector path [s].
        start_tolerance: Largest joint error at which a rollout may start [rad].
        rest_speed: Slower than this the arm is at rest [m/s]; for the rotation of the tool [rad/s]
            four times the number.
        tracking_error: Largest joint error while moving, replaying or holding before it is a fault
            [rad].
        fault_damping: Decay of all joint motion in a fault [1/s].
        teaching_damping: Decay of all joint motion while teaching, at `teaching_speed` [1/s]. It
            grows with the square of the speed, so it is not felt at low speed and takes about 10 N
            at 2.5 m/s.
        teaching_speed: [m/s].
        velocity_cutoff: Of the low-pass for differentiated positions when a driver sends no
            velocity [rad/s]; libbarrett uses 180.
        stale: Without states for longer than this the next one is a fault [s].
        stiffness_max: Largest stiffness a policy may ask for [1/s^2]. With a damping of 32 1/s and
            a delay of 8 ms the loop is stable to about 2800, with 4 ms to about 4800.

    Raises:
        ValueError: A value out of range.
    """

    period: float = 0.002
    driver_compensates_gravity: bool = False
    hold_to_run: bool = False
    law: TorqueLaw = field(default_factory=TorqueLaw)
    limits: Limits | None = None
    hold_bandwidth: float = 25.0
    hold_damping_ratio: float = 0.7
    friction_share: float = 0.8
    move_speed: float = 0.3
    brake_time: float = 0.15
    settle_time: float = 1.0
    path_period: float = 0.01
    start_tolerance: float = 0.05
    rest_speed: float = 0.05
    tracking_error: float = 0.3
    fault_damping: float = 20.0
    teaching_damping: float = 1.0
    teaching_speed: float = 2.5
    velocity_cutoff: float = 180.0
    stale: float = 0.02
    stiffness_max: float = 2500.0

    def __post_init__(self) -> None:
        other = ("driver_compensates_gravity", "hold_to_run", "law", "limits", "friction_share")
        for name, value in vars(self).items():
            if name not in other and not 0.0 < value < math.inf:
                raise ValueError(f"{name} = {value} must be positive and finite")
        if not 0.0 <= self.friction_share <= 1.0:
            raise ValueError(f"friction_share = {self.friction_share} must be in [0, 1]")
        if self.path_period < self.period:
            raise ValueError(f"path_period = {self.path_period} must be at least {self.period}")
