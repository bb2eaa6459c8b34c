# SPDX-License-Identifier: Apache-2.0
"""Parameters of the torque controller, and the controller built from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import Self

from wam_power_ros.control.arm import Arm, guarded_points
from wam_power_ros.control.controller_settings import ControllerSettings, MotionSettings
from wam_power_ros.control.corrections import Corrections
from wam_power_ros.control.safety import limits_of
from wam_power_ros.faults import Fault
from wam_power_ros.learning.policy import PERIOD
from wam_power_ros.params.node_params import Params
from wam_power_ros.regions import Region, region_of

if TYPE_CHECKING:
    from rclpy.node import Node

    from wam_power_ros.control.controller import Controller

JOINTS_MAX = 16
Joints = Annotated[
    tuple[Annotated[str, Field(min_length=1)], ...],
    Field(min_length=1, max_length=JOINTS_MAX, description="as many as a policy can have"),
]
GuardedNames = Annotated[tuple[str, ...], Field(min_length=1, max_length=8)]
Length = Annotated[float, Field(ge=-5.0, le=5.0)]
Unit = Annotated[float, Field(ge=-1.0, le=1.0)]
Corner = tuple[Length, Length, Length]
REACH = "in m: no arm of these set-ups reaches 5 m"
Speed = Annotated[float, Field(ge=0.05, le=6.0)]
Friction = Annotated[float, Field(ge=-1.0, le=100.0)]
FrictionShare = Annotated[float, Field(ge=-0.5, le=0.5)]
JointZero = Annotated[float, Field(ge=-0.2, le=0.2)]
Scale = Annotated[float, Field(ge=0.5, le=1.5)]
PositionLimits = Annotated[
    tuple[Annotated[float, Field(ge=-12.6, le=12.6)], ...],
    Field(min_length=1, max_length=2 * JOINTS_MAX, description="in rad, or m of a slide"),
]
Kilograms = Annotated[float, Field(ge=-5.0, le=20.0)]
Moment = Annotated[float, Field(ge=-5.0, le=5.0)]
Tilt = Annotated[float, Field(ge=-0.35, le=0.35)]
# Bounds on a real arm, stricter than in simulation, where nobody can be hurt.
ON_AN_ARM = {
    "state_timeout": 0.02,  # [s] after which libfranka and Universal Robots stop
    "stiffness_max": 2800.0,  # [1/s^2] stable with 8 ms of delay and a damping of 32 1/s
    "torque_rate_max": 2000.0,  # [N m/s] enough for any toss; see `safety.Limits`
}


def require_same_joints(joint_names: Sequence[str], model_joint_names: Sequence[str]) -> None:
    """Refuse, by a ValueError, names of the driver that are not those of the model, one by one.

    A name that stands at another joint of the model is one: joints would be taken for each other.
    """
    if len(model_joint_names) != len(joint_names):
        raise ValueError(
            f"model_joint_names {tuple(model_joint_names)} must have one name for each of "
            f"joint_names {tuple(joint_names)}"
        )
    for name, model in zip(joint_names, model_joint_names, strict=True):
        if name != model and name in model_joint_names:
            raise ValueError(
                f"joint_names has {name!r} in the place of {model!r} of model_joint_names: both go "
                "base to tip. The order in the joint states does not matter, they are matched by "
                "name; torques are sent in this order"
            )


def _each(why: str) -> Any:  # noqa: ANN401 - as Field
    """Field of a value for each joint, whose range `why` explains to who is refused."""
    return Field(min_length=1, max_length=JOINTS_MAX, description=why)


class TorqueControllerParams(Params, MotionSettings):
    """Parameters of config/torque_controller.yaml, whose comments explain them."""

    file = "torque_controller.yaml"
    settable: ClassVar[set[str]] = {"move_speed", "torque_share"}

    autostart: bool
    simulation: bool
    realtime_priority: int = Field(ge=0, le=98, description="99 is reserved for kernel threads")
    hardware_id: str
    joint_names: Joints
    model_joint_names: Joints
    state_topic: str = Field(min_length=1)
    velocity_topic: str
    command_topic: str = Field(min_length=1)
    command_type: Literal["multiarray", "joint_state"]
    output: Literal["torque", "position", "trajectory", "pose"]
    set_point_period: float = Field(
        ge=0.0, le=0.02, description="in s: 0 for one to each state; beyond, the arm moves in steps"
    )
    effort: Literal["torque", "external", "current", "none"]
    allow_no_realtime: bool
    idle_service: str
    urdf: str
    base_frame: str = Field(min_length=1)
    tool_frame: str
    position_limits: PositionLimits
    joint_zeros: tuple[JointZero, ...] = _each("in rad: re-zero an arm beyond 0.2")
    torque_scales: tuple[Scale, ...] = _each("beyond, the torques' unit is wrong")
    coulomb_friction: tuple[Friction, ...] = _each("in N m; -1: the URDF's")
    viscous_friction: tuple[Friction, ...] = _each("in N m s/rad; -1: the URDF's")
    friction_asymmetry: tuple[FrictionShare, ...] = _each("of the Coulomb friction")
    low_speed_friction: tuple[FrictionShare, ...] = _each("of the Coulomb friction")
    link_masses: tuple[Scale, ...] = _each("beyond, the URDF is of another arm")
    payload: tuple[Kilograms, Moment, Moment, Moment] = Field(
        description="in kg and kg m: beyond the tool that the URDF describes"
    )
    base_tilt: tuple[Tilt, Tilt] = Field(description="in rad: of a base that should be upright")
    state_timeout: float = Field(
        ge=0.0, le=60.0, description="in s: a slow simulation sends a state within a minute"
    )
    torque_share: float = Field(
        ge=0.05, le=1.0, description="of the URDF's limits; below, the arm cannot carry itself"
    )
    torque_rate_max: float = Field(
        ge=50.0,
        le=5000.0,
        description="in N m/s: below, torques cannot follow gravity; above, gears take impacts",
    )
    guarded_names: GuardedNames
    guarded_links: GuardedNames
    guarded_points: tuple[Length, ...] = Field(min_length=1, max_length=24, description=REACH)
    guarded_speed_max: float = Field(
        ge=0.05,
        le=3.0,
        description="in m/s: below, no skill is possible; a toss needs 2, no task here needs 3",
    )
    tool_speed_max: Speed = Field(
        description="in m/s: below, no skill is possible; a toss needs 2.7, no task here needs 6"
    )
    teaching_tool_speed_max: Speed = Field(
        description="in m/s: below, teaching is impossible; nobody guides an arm faster than 6"
    )
    workspace_min: Corner = Field(description=REACH)
    workspace_max: Corner = Field(description=REACH)
    plane: tuple[Unit, Unit, Unit, Length] = Field(
        description="a unit normal, and a distance within 5 m"
    )
    guarded_region: tuple[Length, Length, Length, Annotated[float, Field(ge=0.0, le=2.0)]] = Field(
        description="in m: a sphere within reach, with a radius up to 2"
    )
    guarded_region_name: str = Field(min_length=1)

    @classmethod
    def from_node(cls, node: Node) -> Self:
        """As `Params.of`; simulated time is refused, which would disable a real arm's watchdog."""
        params = super().from_node(node)
        if not params.simulation and node.get_parameter("use_sim_time").value:
            raise ValueError(
                "use_sim_time = True: must be false on a real arm (simulation: false), or lost "
                "states would not be noticed"
            )
        return params

    @model_validator(mode="after")
    def _together(self) -> Self:
        """Check combinations of parameters, and the stricter bounds on a real arm."""
        require_same_joints(self.joint_names, self.model_joint_names)
        _ = self.corrections  # raises for a list of another length
        if 0.0 < self.set_point_period < self.period:
            raise ValueError(
                f"set_point_period = {self.set_point_period} must be 0 or at least the period of "
                f"the states, {self.period}: a set point answers a state"
            )
        if self.simulation:
            return self
        if self.autostart:
            raise ValueError(
                "autostart = True: must be false on a real arm (simulation: false), where a "
                "person activates the controller"
            )
        for name, upper in ON_AN_ARM.items():
            if not 0.0 < (value := getattr(self, name)) <= upper:
                text = f"{name} = {value} must be above 0 and at most {upper:g} on a real arm"
                raise ValueError(f"{text} (simulation: false)")
        return self

    @property
    def message(self) -> str:
        """Kind of the commands, one of `ros.joint_messages.COMMAND_TYPES`."""
        return self.output if self.output in ("trajectory", "pose") else self.command_type

    @property
    def sent_period(self) -> float:
        """Time between two positions that are sent [s]; 0 if torques are sent."""
        return 0.0 if self.output == "torque" else self.set_point_period or self.period

    @property
    def region(self) -> Region | None:
        """Guarded region, None for none."""
        return region_of(self.guarded_region_name, self.guarded_region)

    @property
    def corrections(self) -> Corrections:
        """What was measured on this arm."""
        return Corrections.from_parameters(self.model_dump())

    def arm(self, urdf: str) -> Arm:
        """Build the model of the arm of a URDF; a ValueError names joints and frames it lacks."""
        guarded = guarded_points(self.guarded_names, self.guarded_links, self.guarded_points)
        names, tool = self.model_joint_names, self.tool_frame
        base, allowed = self.base_frame, self.position_limits
        return Arm(urdf, names, tool, guarded, self.corrections, base, allowed)

    def controller(self, urdf: str, latched: Fault | None = None) -> Controller:
        """Build the controller for the arm of a URDF, with a fault that is still latched.

        A ValueError names joints and frames that the URDF lacks, or contradicting limits.
        """
        from wam_power_ros.control.reference_output import controller_of

        arm = self.arm(urdf)
        limits = limits_of(
            arm,
            torque=self.torque_share * arm.tau_max,
            torque_rate=np.full(arm.n, self.torque_rate_max),
            guarded_speed=self.guarded_speed_max,
            tool_speed=self.tool_speed_max,
            teaching_tool_speed=self.teaching_tool_speed_max,
            workspace_min=self.workspace_min,
            workspace_max=self.workspace_max,
            plane=self.plane,
        )
        settings = ControllerSettings(
            **self.model_dump(include=set(MotionSettings.model_fields)),
            limits=limits,
            region=self.region,
            arm=arm.identity(),
        )
        if self.output != "torque":  # the arm carries itself; its model runs at 500 Hz or more
            settings = settings.model_copy(
                update={
                    "period": min(self.period, PERIOD),
                    "state_period": self.period,
                    "set_point_period": self.sent_period,
                    "poses": self.output == "pose",
                    "driver_compensates_gravity": False,
                }
            )
        return controller_of(arm, settings, latched)
