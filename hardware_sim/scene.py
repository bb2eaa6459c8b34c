# SPDX-License-Identifier: Apache-2.0
"""MuJoCo model: the arm of the URDF with its tool, air, ground, light and what a scene adds."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

import mujoco
import numpy as np

from hardware_sim.contact import tool_contact
from hardware_sim.ground_truth import TOOL_SITE
from hardware_sim.hidden_arm import HiddenArm
from hardware_sim.scenes import Scene
from hardware_sim.settings import WorldSettings
from hardware_sim.wam import JOINTS
from wam_power_ros import rotations
from wam_power_ros.control.urdf_checks import MOMENTS, parsed

TIMESTEP = 0.001  # [s] of the physics
AIR_DENSITY = 1.2  # [kg/m^3]
UNIT_MOMENTS = {name: str(float(name[1] == name[2])) for name in MOMENTS}  # [kg m^2]


def build(
    urdf: str,
    scene: Scene,
    settings: WorldSettings,
    hidden: HiddenArm | None = None,
    root: tuple[np.ndarray, np.ndarray] | None = None,
) -> mujoco.MjModel:
    """Compile the model of an arm, which may differ from the text of its URDF, in a scene.

    Its first degrees of freedom are the arm's joints, followed by those of the scene. It has a site
    `TOOL_SITE` at the tool and a site at every guarded point, with its name. `root` is the position
    (3,) [m] and rotation (3, 3) of the URDF's root link in the base frame, the frame of the world.

    Raises:
        ValueError: The text is no URDF.
    """
    friction = settings.friction
    spec = arm(urdf, settings.model_joint_names)
    (hidden or HiddenArm()).change(spec, settings.model_joint_names, settings.tool_frame)
    if root is not None:
        _place(spec, *root)
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
    tree = parsed(urdf)
    for other in tree.iterfind("./joint"):
        if other.get("name") not in joints:
            other.set("type", "fixed")
    moved = _moved(tree)
    for link in tree.iterfind("./link"):
        moments = link.find("inertial/inertia")
        if moments is not None and link.get("name") not in moved:
            moments.attrib.update(UNIT_MOMENTS)  # its own have no effect, and may be of no body
        for shape in [*link.iterfind("visual"), *link.iterfind("collision")]:
            if shape.find("./geometry/mesh") is not None:
                link.remove(shape)
    extension = ElementTree.SubElement(tree, "mujoco")
    # Inertias that `urdf_checks` accepts are made those of bodies, where they are not quite.
    balanced = {"discardvisual": "false", "fusestatic": "false", "balanceinertia": "true"}
    ElementTree.SubElement(extension, "compiler", balanced)
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


def _moved(tree: ElementTree.Element) -> set[str | None]:
    """Names of the links that a joint moves."""
    joints = [
        (each.find("parent").get("link"), each.find("child").get("link"), each.get("type"))  # type: ignore[union-attr]
        for each in tree.iterfind("./joint")
    ]
    moved: set[str | None] = set()
    while found := {c for p, c, kind in joints if kind != "fixed" or p in moved} - moved:
        moved |= found
    return moved


def _place(spec: mujoco.MjSpec, position: np.ndarray, rotation: np.ndarray) -> None:
    """Put the root link of an arm, and gravity, into the base frame."""
    if not position.any() and np.array_equal(rotation, np.eye(3)):
        return  # the numbers stay as they are, bit for bit
    turn = rotations.quat_xyzw(rotation)[[3, 0, 1, 2]]  # MuJoCo has w first
    for part in (*spec.worldbody.bodies, *spec.worldbody.geoms):
        quat = np.zeros(4)
        mujoco.mju_mulQuat(quat, turn, part.quat)
        part.pos, part.quat = position + rotation @ part.pos, quat
    spec.option.gravity = rotation @ spec.option.gravity


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
