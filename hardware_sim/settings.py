# SPDX-License-Identifier: Apache-2.0
"""Settings of the simulated world: arm, drives, sensors and scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from hardware_sim.sensors import MocapSettings
from hardware_sim.wam import JOINTS, N, check_range
from wam_power_ros.control.arm import WAM_GUARDED_POINTS, GuardedPoint
from wam_power_ros.regions import Region

PITCH_RATE = 7.6  # [rad/s] of an expert: most reproductions turn by 90 degrees or more


@dataclass(frozen=True)
class ArmSettings:
    """The simulated arm; by default the WAM.

    Attributes:
        urdf: URDF file, absolute or below the package's share folder.
        joints: Names of the joints from base to tip; seven.
        tool: Link that holds the pan: z normal to the pan, origin on its floor.
        guarded: Points whose speeds are logged; the first as elbow, the last as forearm.
        home: Initial posture [rad]; seven, or None for that of the scene.
        drives: "wam" for the WAM's cables and motors, "direct" for the limits in the URDF.

    Raises:
        ValueError: There are not seven joints, or no guarded points.
    """

    urdf: str = "urdf/wam7.urdf"
    joints: tuple[str, ...] = JOINTS
    tool: str = "pan"
    guarded: tuple[GuardedPoint, ...] = WAM_GUARDED_POINTS
    home: tuple[float, ...] | None = None
    drives: Literal["wam", "direct"] = "wam"

    def __post_init__(self) -> None:
        for name in ("joints", "home"):
            values = getattr(self, name)
            if values is not None and len(values) != N:
                raise ValueError(f"{name} {values} must have {N} entries")
        if not self.guarded:
            raise ValueError("guarded must name at least one point, whose speed is logged")


@dataclass(frozen=True)
class SceneSettings:
    """Settings of the scene and its demonstrations; each scene uses some of them.

    Attributes:
        friction: Sliding friction between pan and body.
        body_offset_sd: Standard deviation of the body's initial position in the pan, per axis [m].
        region: Guarded region of the controller, which a scene may show; None for none.
        body_mass: Mass of the body, relative to nominal.
        body_size: Radius of the body, relative to nominal.
        pitch_rate: Intended pitch rate of a demonstrated toss at the release [rad/s].
        level: True if a demonstrated toss begins with the pan level, the body in its middle.

    Raises:
        ValueError: A value is out of range.
    """

    friction: float = 0.2
    body_offset_sd: float = 0.003
    region: Region | None = None
    body_mass: float = 1.0
    body_size: float = 1.0
    pitch_rate: float = PITCH_RATE
    level: bool = False

    def __post_init__(self) -> None:
        check_range(self, 0.0, 10.0, "friction", "body_offset_sd")
        check_range(self, 0.1, 10.0, "body_mass", "body_size", "pitch_rate")


@dataclass(frozen=True)
class WorldSettings:
    """Settings of the simulated world; the defaults describe the real WAM.

    Attributes:
        bus_voltage: Bus voltage of the motors [V].
        command_delay_ticks: Delay from a torque command to the motors, in control periods.
        wind_sd: Standard deviation of a rollout's steady wind, per axis [m/s].
        torque_scale_sd: Relative standard deviation of each joint's torque constant per rollout.
        friction_sd: Relative standard deviation of each joint's Coulomb friction per rollout.
        friction_share: Coulomb friction of the joints, relative to the URDF.
        torque_constants: Torque constant of each joint, relative to nominal; seven.
        payload: Mass at the tool that is in no model of the arm [kg].
        unknown: Replaces some settings by random ones, see `unknown_world.draw`: never (""), once
            for all rollouts ("session"), or anew for each rollout ("rollout").
        driver_compensates_gravity: True if the driver adds g(q) to the commanded torque.
        watchdog: True if the driver compensates gravity, with damping, after 10 ms without a
            command; otherwise it holds the last command.
        watchdog_damping: Damping in that state [1/s].
        scene: Settings of the scene.
        mocap: Settings of the motion capture.
        arm: Settings of the arm.

    Raises:
        ValueError: A value is out of range.
    """

    bus_voltage: float = 48.0
    command_delay_ticks: int = 2
    wind_sd: float = 0.1
    torque_scale_sd: float = 0.01
    friction_sd: float = 0.1
    friction_share: float = 1.0
    torque_constants: tuple[float, ...] = (1.0,) * N
    payload: float = 0.0
    unknown: Literal["", "session", "rollout"] = ""
    driver_compensates_gravity: bool = False
    watchdog: bool = True
    watchdog_damping: float = 5.0
    scene: SceneSettings = field(default_factory=SceneSettings)
    mocap: MocapSettings = field(default_factory=MocapSettings)
    arm: ArmSettings = field(default_factory=ArmSettings)

    def __post_init__(self) -> None:
        check_range(self, 0, 50, "command_delay_ticks")
        spreads = ("wind_sd", "torque_scale_sd", "friction_sd", "friction_share")
        check_range(self, 0.0, 10.0, *spreads)
        check_range(self, 0.0, 100.0, "watchdog_damping")
        check_range(self, 0.0, 5.0, "payload")
        constants = self.torque_constants
        if len(constants) != N or not all(0.0 < share < 10.0 for share in constants):
            raise ValueError(
                f"torque_constants {constants} must be {N} numbers above 0 and below 10"
            )
