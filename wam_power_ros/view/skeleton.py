# SPDX-License-Identifier: Apache-2.0
"""Arm as shapes for drawing: the shapes of its URDF, placed by forward kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from wam_power_ros import rotations

DEFAULT_RGB = (190, 190, 185)  # of a shape without a material
STICK_RADIUS = 0.03  # [m] of the sticks for an arm without shapes
_SIZE_ATTRIBUTES = {"cylinder": ("radius", "length"), "sphere": ("radius",), "box": ("size",)}


class Shape(NamedTuple):
    """Shape of a link.

    Attributes:
        link: Name of the link it is fixed to.
        kind: "cylinder" along z, "sphere" or "box".
        size: Radius and length, radius, or three edges [m].
        position: Centre in the frame of the link [m]. Shape (3,).
        quat_wxyz: Orientation in the frame of the link. Shape (4,).
        rgb: Colour, 0 to 255.
    """

    link: str
    kind: str
    size: tuple[float, ...]
    position: np.ndarray
    quat_wxyz: np.ndarray
    rgb: tuple[int, int, int]


class Skeleton:
    """Links of an arm, with their shapes and forward kinematics.

    Attributes:
        joint_names: Moving joints, base to tip; others stay at zero.
        links: Links, base to tip.
        shapes: Shapes of the links; sticks if the URDF has none. Meshes are not drawn.
        tool: Link at the tip.

    Args:
        urdf: Text of the URDF.
        joint_names: Moving joints; all joints that are not fixed if omitted.

    Raises:
        ValueError: The text is no URDF, or has no such joint.
    """

    def __init__(self, urdf: str, joint_names: Sequence[str] | None = None) -> None:
        try:
            self._model = pin.buildModelFromXML(urdf)
            tree = ElementTree.fromstring(urdf)
        except (ValueError, RuntimeError, ElementTree.ParseError) as error:
            raise ValueError(f"the robot description is no URDF: {error}") from None
        model = self._model
        known = [name for name in model.names if name != "universe"]
        self.joint_names = tuple(known if joint_names is None else joint_names)
        missing = [name for name in self.joint_names if name not in known]
        if missing or not self.joint_names:
            raise ValueError(f"joints {missing} are not in the robot description; known: {known}")
        self._columns = [model.joints[model.getJointId(name)].idx_q for name in self.joint_names]
        self._data = model.createData()
        self._neutral = pin.neutral(model)
        body = pin.FrameType.BODY
        self._frames = [i for i, frame in enumerate(model.frames) if frame.type == body]
        self.links = tuple(model.frames[i].name for i in self._frames)
        self.tool = self.links[-1]
        self.shapes = _shapes(tree) or self._sticks()

    def placements(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (L, 3) [m] and quaternions wxyz (L, 4) of the links at joint angles (n,)."""
        full = self._neutral.copy()
        full[self._columns] = q
        pin.framesForwardKinematics(self._model, self._data, full)
        placed = [self._data.oMf[i] for i in self._frames]
        quat_xyzw = rotations.quat_xyzw(np.array([place.rotation for place in placed]))
        return np.array([place.translation for place in placed]), np.roll(quat_xyzw, 1, axis=-1)

    def tool_path(self, q: np.ndarray) -> np.ndarray:
        """Positions of the tool [m], shape (T, 3), at joint angles [rad], shape (T, n)."""
        return np.array([self.placements(row)[0][-1] for row in q]).reshape(-1, 3)

    def _sticks(self) -> tuple[Shape, ...]:
        """A cylinder from each link to the next, for a URDF without shapes."""
        places, quats = self.placements(np.zeros(len(self.joint_names)))
        sticks = []
        for i, link in enumerate(self.links[:-1]):
            along = rotations.matrix(np.roll(quats[i], -1)).T @ (places[i + 1] - places[i])
            length = float(np.linalg.norm(along))
            if length > STICK_RADIUS:
                quat_wxyz = np.roll(rotations.quat_xyzw(_turn_z_to(along / length)), 1)
                size = (STICK_RADIUS, length)
                shape = Shape(link, "cylinder", size, along / 2.0, quat_wxyz, DEFAULT_RGB)
                sticks.append(shape)
        return tuple(sticks)


def _turn_z_to(direction: np.ndarray) -> np.ndarray:
    """Rotation matrix that turns z to a unit vector (3,)."""
    axis = np.cross((0.0, 0.0, 1.0), direction)
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, direction[2]))
    return rotations.exp(axis / sine * angle if sine > 1e-9 else np.array([angle, 0.0, 0.0]))


def _shapes(tree: ElementTree.Element) -> tuple[Shape, ...]:
    colours = {
        material.get("name", ""): _rgb(material)
        for material in tree.iter("material")
        if material.find("color") is not None
    }
    shapes = []
    for link in tree.iter("link"):
        for visual in link.iter("visual"):
            geometry = visual.find("geometry/*")
            if geometry is None or geometry.tag not in _SIZE_ATTRIBUTES:
                continue
            numbers = " ".join(geometry.get(name, "") for name in _SIZE_ATTRIBUTES[geometry.tag])
            material = visual.find("material")
            name = "" if material is None else material.get("name", "")
            own = material is not None and material.find("color") is not None
            rgb = _rgb(material) if own else colours.get(name, DEFAULT_RGB)
            origin = _origin(visual.find("origin"))
            size = tuple(_floats(numbers, len(numbers.split())))
            shapes.append(Shape(link.get("name", ""), geometry.tag, size, *origin, rgb))
    return tuple(shapes)


def _origin(origin: ElementTree.Element | None) -> tuple[np.ndarray, np.ndarray]:
    attributes = {} if origin is None else origin.attrib
    roll, pitch, yaw = _floats(attributes.get("rpy", "0 0 0"), 3)
    quat_xyzw = rotations.quat_xyzw(pin.rpy.rpyToMatrix(roll, pitch, yaw))
    return np.array(_floats(attributes.get("xyz", "0 0 0"), 3)), np.roll(quat_xyzw, 1)


def _rgb(material: ElementTree.Element) -> tuple[int, int, int]:
    red, green, blue, _ = _floats(material.find("color").get("rgba", ""), 4)
    return round(255 * red), round(255 * green), round(255 * blue)


def _floats(text: str, count: int) -> list[float]:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not count or not np.isfinite(values).all():
        raise ValueError(f"{text!r} in the robot description must be {count or 'some'} numbers")
    return values
