# SPDX-License-Identifier: Apache-2.0
"""The MuJoCo scene: the arm of the URDF, the pan's contact surfaces, the pancake and the air."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import mujoco
import numpy as np

from wam_power_ros.control.arm import WAM_GUARDED, Guarded

PAN_RADIUS = 0.139  # [m]
PANCAKE_RADIUS = 0.09  # [m]
PANCAKE_HALF_HEIGHT = 0.0025  # [m]
PANCAKE_MASS = 0.026  # [kg], the paper's
_RIM_SEGMENTS = 16
_RIM_HEIGHT = 0.035  # [m]
_RIM_FLARE = 0.6  # [rad] outward: the pan of a person, and a catch forgives some centimetres
_PAN, _PANCAKE = 1, 2  # collision bits: the pancake touches pan and ground, nothing else touches


@dataclass(frozen=True)
class SceneSettings:
    """What of the scene is a choice.

    Attributes:
        timestep: Physics step [s].
        friction: Sliding friction between pancake and pan.
        air_density: [kg/m^3]; drag only.

    Raises:
        ValueError: A value out of range.
    """

    timestep: float = 0.001
    friction: float = 0.2
    air_density: float = 1.2

    def __post_init__(self) -> None:
        if not 0.0 < self.timestep <= 0.002:
            raise ValueError(f"timestep {self.timestep} s must be positive, at most 0.002")
        for name in ("friction", "air_density"):
            if not 0.0 <= getattr(self, name) <= 10.0:
                raise ValueError(f"{name} {getattr(self, name)} must be 0 to 10")


def build(
    urdf: str,
    settings: SceneSettings | None = None,
    tool: str = "pan",
    guarded: Sequence[Guarded] = WAM_GUARDED,
) -> mujoco.MjModel:
    """Compile the scene.

    Args:
        urdf: Text of the arm's URDF.
        settings: None for the defaults.
        tool: Link that holds the pan: z its normal, origin on its floor.
        guarded: Points of the arm whose speeds matter.

    Returns:
        A model whose first degrees of freedom are the arm's joints, and the last six the pancake's;
        with a site "pan" at the tool and one of its name at every guarded point.

    Raises:
        ValueError: The text is no URDF.
    """
    settings = settings or SceneSettings()
    spec = arm(urdf)
    option = spec.option
    option.timestep = settings.timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.density = settings.air_density
    for point in guarded:
        spec.body(point.link).add_site(name=point.name, pos=list(point.offset), group=4)
    spec.body(tool).add_site(name="pan", group=4)
    _add_pan(spec.body(tool), settings)
    _add_pancake(spec.worldbody, settings)
    _add_surroundings(spec, settings)
    model = spec.compile()
    # The ellipsoid model's added mass and lift would cancel the flip of a thin disc: drag alone.
    model.geom_fluid[model.geom("pancake").id, 4:12] = 0.0
    return model


def arm(urdf: str) -> mujoco.MjSpec:
    """The arm alone as the URDF has it: rotors and friction included, its shapes only drawn.

    Args:
        urdf: Text of the URDF.

    Raises:
        ValueError: The text is no URDF.
    """
    try:
        tree = ElementTree.fromstring(urdf)
    except ElementTree.ParseError as error:
        raise ValueError(f"the robot description is no URDF: {error}") from None
    extension = ElementTree.SubElement(tree, "mujoco")
    ElementTree.SubElement(extension, "compiler", discardvisual="false", fusestatic="false")
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(tree, encoding="unicode"))
    for joint in spec.joints:  # MuJoCo reads no armature from a URDF
        dynamics = tree.find(f"./joint[@name='{joint.name}']/dynamics")
        if dynamics is not None:
            joint.armature = float(dynamics.get("armature", "0"))
        joint.solimp_friction = [0.99, 0.999, 0.001, 0.5, 2.0]  # by default a loaded joint creeps
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
        geom.group = 1
    return spec


def _contact(settings: SceneSettings) -> dict[str, object]:
    """Nearly inelastic; MuJoCo's softer default lets a thin disc fall through the pan."""
    return {
        "solref": [0.005, 0.6],
        "solimp": [0.9, 0.97, 0.002, 0.5, 2.0],
        "friction": [settings.friction, 0.005, 0.0001],
        "condim": 4,
    }


def _add_pan(pan: mujoco.MjsBody, settings: SceneSettings) -> None:
    contact = _contact(settings) | {"contype": _PAN, "conaffinity": _PANCAKE, "mass": 0.0}
    colour = [0.13, 0.13, 0.14, 1.0]
    pan.add_geom(
        name="pan_floor",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[PAN_RADIUS, 0.004, 0.0],
        pos=[0.0, 0.0, -0.004],
        rgba=colour,
        **contact,
    )
    length = _RIM_HEIGHT / np.cos(_RIM_FLARE)  # along the flared wall
    outward = PAN_RADIUS + 0.5 * _RIM_HEIGHT * np.tan(_RIM_FLARE)
    width = np.pi * (PAN_RADIUS + _RIM_HEIGHT * np.tan(_RIM_FLARE)) / _RIM_SEGMENTS
    for k in range(_RIM_SEGMENTS):
        angle = 2.0 * np.pi * k / _RIM_SEGMENTS
        tilt = np.array([np.cos(_RIM_FLARE / 2), 0.0, np.sin(_RIM_FLARE / 2), 0.0])  # about y
        turn = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])  # about z
        quat_wxyz = np.zeros(4)
        mujoco.mju_mulQuat(quat_wxyz, turn, tilt)
        pan.add_geom(
            name=f"pan_rim{k}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[0.002, width, 0.5 * length],
            pos=[outward * np.cos(angle), outward * np.sin(angle), 0.5 * _RIM_HEIGHT],
            quat=quat_wxyz,
            rgba=colour,
            **contact,
        )


def _add_pancake(world: mujoco.MjsBody, settings: SceneSettings) -> None:
    body = world.add_body(name="pancake", pos=[0.0, 0.0, 2.0])
    body.add_freejoint(name="pancake")
    body.add_geom(
        name="pancake",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[PANCAKE_RADIUS, PANCAKE_HALF_HEIGHT, 0.0],
        mass=PANCAKE_MASS,
        fluid_ellipsoid=1,
        rgba=[0.95, 0.78, 0.25, 1.0],
        contype=_PANCAKE,
        conaffinity=_PAN,
        **_contact(settings),
    )
    for sign, colour in ((1.0, [0.97, 0.97, 0.95, 1.0]), (-1.0, [0.96, 0.70, 0.10, 1.0])):
        body.add_geom(  # white above, yellow below, as the paper's: to be seen, not felt
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[0.97 * PANCAKE_RADIUS, 0.0004, 0.0],
            pos=[0.0, 0.0, sign * (PANCAKE_HALF_HEIGHT + 0.0002)],
            mass=0.0,
            rgba=colour,
            contype=0,
            conaffinity=0,
        )


def _add_surroundings(spec: mujoco.MjSpec, settings: SceneSettings) -> None:
    """Ground for a pancake that missed, and a light."""
    world = spec.worldbody
    world.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[3.0, 3.0, 0.1],
        rgba=[0.93, 0.93, 0.91, 1.0],
        contype=_PAN,
        conaffinity=_PANCAKE,
        **_contact(settings),
    )
    world.add_light(pos=[0.5, -1.0, 3.0], dir=[0.0, 0.3, -1.0], castshadow=True)
