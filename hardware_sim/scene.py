# SPDX-License-Identifier: Apache-2.0
"""MuJoCo model: the arm of the URDF with its tool, air, ground, light and what a scene adds."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

import mujoco
import numpy as np

from hardware_sim.ground_truth import TOOL_SITE
from hardware_sim.hidden_arm import HiddenArm
from hardware_sim.scenes import Scene
from hardware_sim.settings import WorldSettings
from hardware_sim.wam import JOINTS

TIMESTEP = 0.001  # [s] of the physics
AIR_DENSITY = 1.2  # [kg/m^3]
WALLS, WALL = 16, 0.002  # boxes around a vessel, and their half thickness [m]
_FIXED, _BODY = 1, 2  # collision bits: only bodies collide, with tool and ground


def build(
    urdf: str, scene: Scene, settings: WorldSettings, hidden: HiddenArm | None = None
) -> mujoco.MjModel:
    """Compile the model of an arm, which may differ from the text of its URDF, in a scene.

    Its first degrees of freedom are the arm's joints, followed by those of the scene. It has a site
    `TOOL_SITE` at the tool and a site at every guarded point, with its name.

    Raises:
        ValueError: The text is no URDF.
    """
    friction = settings.friction
    spec = arm(urdf, settings.model_joint_names)
    (hidden or HiddenArm()).change(spec, settings.model_joint_names, settings.tool_frame)
    option = spec.option
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.density = AIR_DENSITY
    for point in settings.guarded:
        spec.body(point.link).add_site(name=point.name, pos=list(point.offset), group=4)
    tool = spec.body(settings.tool_frame)
    tool.add_site(name=TOOL_SITE, group=4)
    scene.build(spec, tool)
    _add_surroundings(spec, friction)
    model = spec.compile()
    # Drag alone: the ellipsoid model's added mass and lift would cancel the flip of a thin disc.
    # After this line mj_setConst must not be called: it would restore the added mass.
    model.geom_fluid[:, 4:12] = 0.0
    return model


def arm(urdf: str, joints: Sequence[str] = JOINTS) -> mujoco.MjSpec:
    """Model of the arm alone from its URDF, with rotor inertia and friction, without collisions.

    Other joints, such as those of a gripper, are locked at zero; meshes are left out.

    Raises:
        ValueError: The text is no URDF.
    """
    try:
        tree = ElementTree.fromstring(urdf)
    except ElementTree.ParseError as error:
        raise ValueError(f"the robot description is no URDF: {error}") from None
    for other in tree.iterfind("./joint"):
        if other.get("name") not in joints:
            other.set("type", "fixed")
    for link in tree.iterfind("./link"):
        for shape in [*link.iterfind("visual"), *link.iterfind("collision")]:
            if shape.find("./geometry/mesh") is not None:
                link.remove(shape)
    extension = ElementTree.SubElement(tree, "mujoco")
    ElementTree.SubElement(extension, "compiler", discardvisual="false", fusestatic="false")
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(tree, encoding="unicode"))
    for joint in spec.joints:  # MuJoCo reads no armature from a URDF
        dynamics = tree.find(f"./joint[@name='{joint.name}']/dynamics")
        if dynamics is not None:
            joint.armature = float(dynamics.get("armature", "0"))
        # with the default a loaded joint creeps
        joint.solimp_friction = [0.99, 0.999, 0.001, 0.5, 2.0]
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
        geom.mass = 0.0  # a link has the mass of its <inertial> element alone
        geom.group = 1
    return spec


def body_contact(friction: float) -> dict[str, object]:
    """Geom arguments for the contact of a body with tool and ground."""
    return tool_contact(friction) | {"contype": _BODY, "conaffinity": _FIXED}


def tool_contact(friction: float) -> dict[str, object]:
    """Geom arguments for the contact of the tool with a body.

    Nearly inelastic: MuJoCo's softer default lets a thin disc fall through a tool.
    """
    return {
        "solref": [0.005, 0.6],
        "solimp": [0.9, 0.97, 0.002, 0.5, 2.0],
        "friction": [friction, 0.005, 0.0001],
        "condim": 4,
        "contype": _FIXED,
        "conaffinity": _BODY,
    }


def add_body(spec: mujoco.MjSpec, name: str, friction: float, **shape: object) -> mujoco.MjsBody:
    """Add a body on a free joint that tool and ground touch and air slows down.

    Body, joint and geom have the same name; `shape` are other arguments of the geom.
    """
    body = spec.worldbody.add_body(name=name, pos=[0.0, 0.0, 2.0])
    body.add_freejoint(name=name)
    body.add_geom(name=name, fluid_ellipsoid=1, **shape, **body_contact(friction))
    return body


def add_vessel(
    tool: mujoco.MjsBody,
    name: str,
    radius: float,
    height: float,
    width: float,
    flare: float = 0.0,
    floor: float = WALL,
    **contact: object,
) -> None:
    """Add a round vessel without mass to the tool: a floor below its origin, a wall of boxes.

    Args:
        tool: Body of the tool.
        name: Begins the names of its geoms.
        radius: Radius of the floor [m].
        height: Height of the wall [m].
        width: Half width of each of its `WALLS` boxes [m].
        flare: Angle of the wall outward [rad].
        floor: Half thickness of the floor [m].
        **contact: Other arguments of its geoms.
    """
    contact |= {"mass": 0.0}
    tool.add_geom(
        name=f"{name}_floor",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[radius, floor, 0.0],
        pos=[0.0, 0.0, -floor],
        **contact,
    )
    outward = radius + 0.5 * height * np.tan(flare)
    tilt = np.array([np.cos(flare / 2), 0.0, np.sin(flare / 2), 0.0])  # about y
    for k in range(WALLS):
        angle = 2.0 * np.pi * k / WALLS
        turn = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])  # about z
        quat_wxyz = np.zeros(4)
        mujoco.mju_mulQuat(quat_wxyz, turn, tilt)
        tool.add_geom(
            name=f"{name}_wall{k}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[WALL, width, 0.5 * height / np.cos(flare)],
            pos=[outward * np.cos(angle), outward * np.sin(angle), 0.5 * height],
            quat=quat_wxyz,
            **contact,
        )


def _add_surroundings(spec: mujoco.MjSpec, friction: float) -> None:
    """Ground for a body that missed the tool, and a light."""
    world = spec.worldbody
    world.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[3.0, 3.0, 0.1],
        rgba=[0.93, 0.93, 0.91, 1.0],
        **tool_contact(friction),
    )
    world.add_light(pos=[0.5, -1.0, 3.0], dir=[0.0, 0.3, -1.0], castshadow=True)
