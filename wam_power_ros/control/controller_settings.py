# SPDX-License-Identifier: Apache-2.0
"""Settings of the torque controller."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, InstanceOf

from wam_power_ros.arm_identity import ArmIdentity
from wam_power_ros.control.safety import Limits
from wam_power_ros.regions import Region


def _within(default: float, least: float, most: float, why: str) -> Any:  # noqa: ANN401 - as Field
    """Field from `least` to `most`, which `why` explains to who is refused."""
    return Field(default=default, ge=least, le=most, description=why)


class MotionSettings(BaseModel):
    """Settings that are parameters of the node; the defaults suit the Barrett WAM with a pan.

    Attributes:
        period: Sampling period of the joint states [s].
        driver_compensates_gravity: The driver adds g(q) itself; it is left out of what is sent.
        hold_to_run: Teaching, replay and the first run of a policy need `Controller.enabled`.
        law: Name of the torque law, a function of `torque_law`.
        move_speed: Peak joint speed of a move to the start [rad/s].
        start_tolerance: Largest joint error at which a rollout may start [rad].
        settle_time: Time that a rollout continues after the end of its movement [s].
        velocity_cutoff: Cut-off of the low-pass for differentiated positions when a driver sends
            no velocity, and in the simulation of a policy [rad/s]; libbarrett uses 180.
        stiffness_max: Largest stiffness of a policy [1/s^2]. With a damping of 32 1/s the loop is
            stable up to about 2800 with a delay of 8 ms, up to about 4800 with 4 ms.
        damping_max: Largest damping of a policy [1/s]. Its product with the delay of the loop must
            stay well below pi / 2: with 8 ms the loop is unstable from 196 on.
        teaching_friction: Share of the Coulomb friction that is taken off a joint which a person
            moves; more than 0.8 of the true one lets the arm run on after it was let go.
        loop_delay: Time from a torque to the motion that the states show [s].
        servo_delay: Delay with which an arm follows positions [s].
        servo_lag: Time constant of the low-pass with which it does [s].
        contact_share: Bound on the torque residual in hold, move and replay, beyond twice the
            joint's friction, as a share of the joint's torque limit; above it is a contact, and a
            fault.
        unexplained_share: The same bound in rollouts, where the arm is faster and makes contact.

    Raises:
        ValueError: A value is out of range; the message names it.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    period: float = _within(
        0.002, 0.0005, 0.02, "in s: below, Python is too slow; above, control is unstable"
    )
    driver_compensates_gravity: bool = False
    hold_to_run: bool = False
    law: Literal["operational_space", "virtual_mass"] = "operational_space"
    move_speed: float = _within(
        0.3, 0.01, 1.0, "in rad/s: below, a move takes minutes; at 1 an outstretched tool has 1 m/s"
    )
    start_tolerance: float = _within(
        0.05, 0.001, 0.2, "in rad: above encoder noise; beyond 0.2, another posture"
    )
    settle_time: float = Field(
        default=1.0,
        gt=0.0,
        le=10.0,
        description="in s: an arm that is not at rest by then will not be",
    )
    velocity_cutoff: float = _within(
        180.0,
        10.0,
        1500.0,
        "in rad/s: below, damping lags too much; above, it is near half of 500 Hz",
    )
    stiffness_max: float = _within(
        2500.0,
        10.0,
        4800.0,
        "in 1/s^2: below, no policy is accepted; 4800 is stable with 4 ms of delay",
    )
    damping_max: float = _within(
        100.0, 1.0, 150.0, "in 1/s: from 196 on a loop with 8 ms of delay is unstable"
    )
    teaching_friction: float = _within(
        0.0, 0.0, 0.8, "a share; with all of it and 20 % the arm runs away"
    )
    loop_delay: float = _within(0.0, 0.0, 0.03, "in s: 0 if not measured; beyond, unstable")
    servo_delay: float = _within(0.0, 0.0, 0.2, "in s: 0 if not measured; beyond, a fault")
    servo_lag: float = _within(0.0, 0.0, 0.1, "in s: 0 if not measured; beyond, a fault")
    contact_share: float = _within(
        0.05, 0.02, 0.5, "of a torque limit: above encoder noise, below a harmful push"
    )
    unexplained_share: float = _within(
        0.25, 0.1, 0.5, "of a torque limit: above model errors, below a harmful push"
    )


class ControllerSettings(MotionSettings):
    """Settings of the controller of one arm.

    Attributes:
        limits: Limits of the arm, None for those of its URDF with the defaults of `safety.Limits`.
        region: Guarded region, which ends a rollout; None for none.
        arm: Identity of the arm that a policy must match, if it names one; None to accept any.
        set_point_period: Time between two references that are sent [s]; 0 if torques are sent.
        poses: Whether references are poses of the tool, not positions of the joints.
        state_period: Sampling period of the joint states, if it is not `period` [s].
    """

    limits: InstanceOf[Limits] | None = None
    region: InstanceOf[Region] | None = None
    arm: InstanceOf[ArmIdentity] | None = None
    set_point_period: float = 0.0
    poses: bool = False
    state_period: float = 0.0
