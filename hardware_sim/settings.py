# SPDX-License-Identifier: Apache-2.0
"""Settings of the simulated world, and parameters of the stand-ins, which include them."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator
from typing_extensions import Self

from hardware_sim.sensors import MocapSettings
from hardware_sim.wam import JOINTS, PERIOD
from wam_power_ros.control.arm import GuardedPoint, guarded_points
from wam_power_ros.params.body_tracker_params import MocapTopics
from wam_power_ros.params.node_params import Names, Params
from wam_power_ros.params.torque_controller_params import (
    JOINTS_MAX,
    Joints,
    PositionLimits,
    require_same_joints,
)
from wam_power_ros.regions import Region, region_of
from wam_power_ros.tracking.tracker import WorldToBase

REACH_GOAL = (0.78, 0.25, 0.6)  # [m] half a metre to the left of the WAM's tool at its home
PITCH_RATE = 7.6  # [rad/s] of an expert: most reproductions turn by 90 degrees or more
Length = Annotated[float, Field(ge=-5.0, le=5.0, description="in m: beyond the reach of the arm")]
Radius = Annotated[float, Field(ge=0.0, le=2.0)]
Angle = Annotated[float, Field(ge=-10.0, le=10.0, description="in rad: beyond any joint limit")]
Spread = Annotated[float, Field(ge=0.0, le=10.0, description="far above any real value")]
Scale = Annotated[float, Field(ge=0.1, le=10.0, description="relative to nominal")]
Sent = Literal["filled", "empty", "nan"]


class WorldSettings(BaseModel):
    """Settings of the simulated world, as config/wam_sim.yaml describes them with their units.

    The defaults describe the real WAM and its tool; without `home` it begins in that of the scene.
    Each scene uses some of the settings from `friction` on. No file has:

    Attributes:
        friction_share: Coulomb friction of the joints, relative to the URDF.
        body_mass: Mass of the body, relative to nominal.
        body_size: Radius of the body, relative to nominal.
        level: True if a demonstrated toss begins with the tool level, the body in its middle.

    Raises:
        ValueError: A value is out of range, or does not fit the number of joints.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    urdf: str = "urdf/wam7.urdf"
    model_joint_names: Joints = JOINTS
    base_frame: str = ""
    tool_frame: str = "pan"
    position_limits: PositionLimits = (0.0,)
    guarded_names: Names = ("elbow", "forearm")
    guarded_links: Names = ("wam_link4", "wam_link4")
    guarded_points: tuple[Length, ...] = Field((0.0, 0.0, 0.0, -0.045, -0.35, 0.0), max_length=24)
    home: tuple[Angle, ...] | None = Field(None, max_length=JOINTS_MAX)
    drives: Literal["wam", "direct"] = "wam"
    bus_voltage: float = Field(48.0, ge=1.0, le=100.0, description="in V: 48 for the WAM")
    period: float = Field(PERIOD, ge=0.001, le=0.01, description="in s: 1000 to 100 Hz")
    command_delay_ticks: int = Field(2, ge=0, le=50, description="beyond 0.1 s: unstable")
    driver_compensates_gravity: bool = False
    output: Literal["torque", "position", "trajectory", "pose"] = "torque"
    servo_lag: float = Field(0.01, ge=0.0, le=0.2, description="in s: of position servos")
    watchdog: bool = True
    wind_sd: Spread = 0.1
    torque_scale_sd: Spread = 0.01
    friction_sd: Spread = 0.1
    friction_share: Spread = 1.0
    unknown: Literal["", "session", "lab"] = ""
    friction: Spread = 0.2
    body_offset_sd: Spread = 0.003
    body_mass: Scale = 1.0
    body_size: Scale = 1.0
    guarded_region: tuple[Length, Length, Length, Radius] = (0.0, 0.0, 0.0, 0.0)
    goal: tuple[Length, Length, Length] = REACH_GOAL
    spread: Spread = 1.0
    string: Scale = Field(0.4, description="in m")
    pitch_rate: Scale = Field(PITCH_RATE, description="in rad/s: 10 is faster than any wrist")
    level: bool = False

    @property
    def region(self) -> Region | None:
        """Guarded region of the controller; None for none."""
        return region_of("region", self.guarded_region)

    @property
    def guarded(self) -> tuple[GuardedPoint, ...]:
        """Points whose speeds are logged: the tool if there are no others."""
        found = guarded_points(self.guarded_names, self.guarded_links, self.guarded_points)
        return found or (GuardedPoint("tool", self.tool_frame, (0.0, 0.0, 0.0)),)

    @property
    def period_ns(self) -> int:
        """Control period of the driver [ns]."""
        return round(self.period * 1e9)

    def ticks(self, seconds: float) -> int:
        """Number of control periods in a time [s]."""
        return round(seconds / self.period)

    @model_validator(mode="after")
    def _fit_the_arm(self) -> Self:
        names, n = self.model_joint_names, len(self.model_joint_names)
        if self.drives == "wam" and n != len(JOINTS):
            raise ValueError(
                f"drives = wam: they have {len(JOINTS)} joints, not the {n} of {names}; set direct "
                "for another arm"
            )
        if self.period_ns % 1_000_000:
            raise ValueError(f"period = {self.period} must be a multiple of 0.001 s")
        if self.home is not None and len(self.home) != n:
            raise ValueError(f"home = {self.home} must be {n} angles, one for each of {names}")
        guarded_points(self.guarded_names, self.guarded_links, self.guarded_points)
        return self


class ArmSimParams(Params, WorldSettings):
    """Parameters of config/wam_sim.yaml, settings of the world included."""

    file = "wam_sim.yaml"
    constants: ClassVar[set[str]] = {"friction_share", "body_mass", "body_size", "level"}

    pace: Literal["lockstep", "real_time"]
    seed: int = Field(ge=0, le=2**63 - 1, description="a ROS integer")
    realtime_priority: int = Field(ge=0, le=98, description="99 is for the kernel's own threads")
    joint_names: Joints
    other_joints: Names
    state_topic: str
    velocity: Sent
    effort: Literal["external", "current", "filled", "empty", "nan"]
    state_order: Literal["joint_names", "sorted"]
    velocity_topic: str
    command_topic: str
    command_type: Literal["multiarray", "joint_state"]
    listeners: tuple[str, ...] = Field(max_length=100)
    deactivates: bool
    scene: str

    @property
    def lockstep(self) -> bool:
        """Whether each step waits for its torque."""
        return self.pace == "lockstep"

    @model_validator(mode="after")
    def _fit_the_driver(self) -> Self:
        require_same_joints(self.joint_names, self.model_joint_names)
        return self


class OptitrackSimParams(MocapTopics, Params, MocapSettings):
    """Parameters of config/optitrack_sim.yaml, settings of the motion capture included."""

    file = "optitrack_sim.yaml"

    frame: str
    reliable: bool
    up_axis: Literal["z", "y"]
    world_to_base: WorldToBase
    stamps: Literal["exposure", "receipt"]
    together: int = Field(ge=1, le=10)
    stray: int = Field(ge=0, le=3, description="markers of other objects")
