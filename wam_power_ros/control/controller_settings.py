# SPDX-License-Identifier: Apache-2.0
"""Settings of the torque controller."""

import math
from dataclasses import dataclass

from wam_power_ros.arm_identity import ArmIdentity
from wam_power_ros.control.safety import Limits
from wam_power_ros.regions import Region

LAWS = ("operational_space", "virtual_mass")  # functions of `torque_law`


@dataclass(frozen=True)
class ControllerSettings:
    """Settings of the controller; the defaults suit the Barrett WAM with a pan.

    Attributes:
        period: Sampling period of the joint states [s].
        driver_compensates_gravity: The driver adds g(q) itself; it is left out of what is sent.
        hold_to_run: Teaching, replay and the first run of a policy need `Controller.enabled`.
        law: Name of the torque law, one of LAWS.
        limits: Limits of the arm, None for those of its URDF with the defaults of `safety.Limits`.
        region: Guarded region, which ends a rollout; None for none.
        move_speed: Peak joint speed of a move to the start [rad/s].
        start_tolerance: Largest joint error at which a rollout may start [rad].
        settle_time: Time that a rollout continues after the end of its movement [s].
        velocity_cutoff: Cut-off of the low-pass for differentiated positions when a driver sends
            no velocity [rad/s]; libbarrett uses 180.
        stiffness_max: Largest stiffness of a policy [1/s^2]. With a damping of 32 1/s the loop is
            stable up to about 2800 with a delay of 8 ms, up to about 4800 with 4 ms.
        damping_max: Largest damping of a policy [1/s]. Its product with the delay of the loop must
            stay well below pi / 2: with 8 ms the loop is unstable from 196 on.
        contact_share: Bound on the torque residual in hold, move and replay, beyond twice the
            joint's friction, as a share of the joint's torque limit; above it is a contact, and a
            fault.
        unexplained_share: The same bound in rollouts, where the arm is faster and makes contact.
        arm: Identity of the arm that a policy must match, if it names one; None to accept any.

    Raises:
        ValueError: A value is out of range.
    """

    period: float = 0.002
    driver_compensates_gravity: bool = False
    hold_to_run: bool = False
    law: str = "operational_space"
    limits: Limits | None = None
    region: Region | None = None
    move_speed: float = 0.3
    start_tolerance: float = 0.05
    settle_time: float = 1.0
    velocity_cutoff: float = 180.0
    stiffness_max: float = 2500.0
    damping_max: float = 100.0
    contact_share: float = 0.05
    unexplained_share: float = 0.25
    arm: ArmIdentity | None = None

    def __post_init__(self) -> None:
        if self.law not in LAWS:
            raise ValueError(f"torque law {self.law!r} must be one of {LAWS}")
        for name, value in vars(self).items():
            if isinstance(value, float) and not 0.0 < value < math.inf:
                raise ValueError(f"{name} = {value} must be positive and finite")
