# SPDX-License-Identifier: Apache-2.0
"""Checks of a URDF: which joints an arm can have, and that its links are physical bodies.

Bodies that are fixed to each other count as one: many descriptions have frames without mass, and
sensors or flanges with placeholders, which are harmless beside what they are fixed to.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
import pinocchio as pin

LEVER_MAX = 5.0  # [m] from a joint to the centre of mass of its body; beyond it are millimetres
# Share of the largest principal moment. The largest may exceed the sum of the others by more than
# rounding: identified models of real robots do by 0.26, an exchanged digit does by more.
TRIANGLE_SHARE = 0.3
NEGATIVE_SHARE = 1e-3  # of the largest principal moment: rounding of a thin rod
ROUNDING = 1e-12  # [kg m^2] of the sums over links that are fixed to each other
# Smallest eigenvalue of the mass matrix scaled to a unit diagonal: 8e-7 to 0.3 in descriptions of
# 40 real robots, below 1e-12 for a point mass on a joint's axis.
EIGENVALUE_MIN = 1e-9
_POSTURES = 8  # at which the mass matrix is checked
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_LIMITED = ("revolute", "prismatic")


class Approach(NamedTuple):
    """Speed sqrt(2 d r) - o that a joint may have at a distance r from the limit ahead.

    Attributes:
        offset: o [rad/s].
        deceleration: d [rad/s^2].
    """

    offset: float
    deceleration: float


def parsed(urdf: str) -> ElementTree.Element:
    """Parse a URDF as urdfdom does, which knows no namespaces: a prefix needs no declaration.

    Attributes and elements with a prefix are left out.

    Raises:
        ValueError: The text is no URDF.
    """
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(urdf, True)
    except (expat.ExpatError, ValueError) as error:
        raise ValueError(f"the robot description is not a URDF: {error}") from None
    tree = builder.close()
    if tree.tag != "robot":
        of = {"mujoco": " of MuJoCo", "sdf": " of Gazebo"}.get(tree.tag, "")
        raise ValueError(f"the robot description is not a URDF: it begins with <{tree.tag}>{of}")
    for element in tree.iter():
        element[:] = [child for child in element if ":" not in child.tag]
        for name in [name for name in element.keys() if name == "xmlns" or ":" in name]:
            del element.attrib[name]
    return tree


def limited(urdf: str, joint_names: Sequence[str], limits: Sequence[float]) -> str:
    """Replace position limits of a URDF; a continuous joint becomes a revolute one.

    Args:
        limits: Lower and upper limit of each joint [rad]; 0 and 0 keep those of the URDF. One 0 or
            none keeps all.

    Raises:
        ValueError: Their number is not twice that of the joints, or limits of a joint are not
            within those of the URDF, or of a continuous joint not within a turn.
    """
    if not any(limits):
        return urdf
    n = len(joint_names)
    if len(limits) != 2 * n:
        text = f"position_limits {list(limits)} must be {2 * n} numbers, lower and upper for each"
        raise ValueError(f"{text} of {list(joint_names)}; 0, 0 keeps those of the URDF")
    tree = parsed(urdf)
    for name, low, high in zip(joint_names, limits[::2], limits[1::2], strict=True):
        joint = tree.find(f"./joint[@name='{name}']")
        if low == high == 0.0 or joint is None:
            continue
        if (given := joint.find("limit")) is None:
            given = ElementTree.SubElement(joint, "limit")
        if joint.get("type") == "continuous":
            allowed, within = "a turn", high - low < 2.0 * math.pi
            joint.set("type", "revolute")
        else:
            least, most = number(given.get("lower", "nan")), number(given.get("upper", "nan"))
            allowed = f"those of the URDF, {least:g} to {most:g}"
            within = least <= low and high <= most
        if not (within and low < high):
            text = f"position_limits of joint {name!r}, {low:g} to {high:g}, must rise, within"
            raise ValueError(f"{text} {allowed}")
        given.attrib.update(lower=repr(float(low)), upper=repr(float(high)))
    return ElementTree.tostring(tree, encoding="unicode")


def soft_limits(tree: ElementTree.Element, joint_name: str) -> tuple[float, float]:
    """Bounds of a position by the maker's own controller [rad]; infinite if there are none."""
    safety = tree.find(f"./joint[@name='{joint_name}']/safety_controller")
    found = {} if safety is None else safety.attrib
    low, high = (number(found.get(f"soft_{end}_limit", "0")) for end in ("lower", "upper"))
    return (low, high) if low < high else (-math.inf, math.inf)


def approach(tree: ElementTree.Element, joint_names: Sequence[str]) -> tuple[Approach, ...]:
    """Speeds near the position limits of each joint; empty if a joint has none.

    They are in the element `<position_based_velocity_limits>` of Franka's descriptions.
    """
    found = (
        tree.find(f"./joint[@name='{name}']/position_based_velocity_limits") for name in joint_names
    )
    given = [{} if each is None else dict(each.items()) for each in found]
    names = "velocity_offset", "deceleration_limit"
    values = [Approach(*(number(each.get(name, "")) for name in names)) for each in given]
    return tuple(values) if np.isfinite(values).all() else ()


def require_usable(tree: ElementTree.Element, joint_names: Sequence[str]) -> None:
    """Refuse joints that an arm cannot have; those of the URDF that are not named are locked.

    Raises:
        ValueError: A joint of the arm is missing, fixed, continuous, mimics another one, or lacks a
            limit, or a joint that is not of the arm mimics one of the arm. It names the joint.
    """
    joints = {joint.get("name", ""): joint for joint in tree.iterfind("./joint")}
    known = [name for name, joint in joints.items() if joint.get("type") != "fixed"]
    missing = [name for name in joint_names if name not in joints]
    if missing or not joint_names:
        raise ValueError(f"joints {missing} are not in the robot description; known: {known}")
    for name in joint_names:
        if reason := _unusable(joints[name], known):
            raise ValueError(f"joint {name!r} {reason}")
        _require_limits(name, joints[name])
    for name in set(known) - set(joint_names):
        mimic = joints[name].find("mimic")
        if mimic is not None and (leader := mimic.get("joint")) in joint_names:
            raise ValueError(
                f"joint {name!r} mimics {leader!r} of the arm and would be locked: an arm "
                "is a chain of independent joints; fix it in a URDF of your own"
            )


def _unusable(joint: ElementTree.Element, known: list[str]) -> str:
    """Why an arm cannot have this joint, with the remedy; empty if it can."""
    kind, mimic = joint.get("type"), joint.find("mimic")
    if kind == "fixed":
        return f"is fixed in the robot description; movable are {known}"
    if kind == "continuous":
        return (
            "is continuous: a driver may wrap its positions, which then jump; give it limits "
            "between which they do not, such as -3.1, 3.1, in position_limits of the set-up"
        )
    if kind not in _LIMITED:
        return f"is of type {kind!r}; allowed are {list(_LIMITED)}"
    if mimic is not None:
        text = f"mimics {mimic.get('joint')!r} and cannot be commanded: leave it out"
        return f"{text} of model_joint_names and joint_names"
    return ""


def _require_limits(name: str, joint: ElementTree.Element) -> None:
    limit = joint.find("limit")
    given = {} if limit is None else dict(limit.items())
    lower = -math.inf
    for attribute in ("lower", "upper", "velocity", "effort"):
        if (text := given.get(attribute)) is None:
            raise ValueError(
                f"joint {name!r} has no limit {attribute!r}: add <limit lower= upper= velocity= "
                "effort=> with the values that its maker states"
            )
        above = {"lower": -math.inf, "upper": lower}.get(attribute, 0.0)
        if not above < (value := number(text)) < math.inf:
            raise ValueError(
                f"limit {attribute} = {text!r} of joint {name!r} must be a finite number above "
                f"{above:g}: take the value that its maker states"
            )
        lower = value if attribute == "lower" else lower


def require_physical(tree: ElementTree.Element, model: pin.Model) -> None:
    """Refuse an arm whose moving links are no physical bodies: its model cannot carry it.

    Args:
        model: Chain of the arm's joints, whose other joints are locked; without rotor inertias.

    Raises:
        ValueError: An `<inertial>` cannot be read, what a joint moves has no mass, an inertia is
            that of no body, or the mass matrix is not positive definite. It names the links.
    """
    links: list[list[str]] = [[] for _ in range(model.njoints)]  # behind each joint
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            links[frame.parentJoint].append(frame.name)
    moving = set().union(*links[1:])
    for link in tree.iterfind("./link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        if name in moving and inertial is not None:
            _require_numbers(name, inertial)
    data, joints = model.createData(), range(1, model.njoints)
    pin.computeSubtreeMasses(model, data)
    without = [name for joint in joints if data.mass[joint] <= 0.0 for name in links[joint]]
    if without:
        raise ValueError(
            f"links {without} move without mass: each link of an arm needs an <inertial> with the "
            "mass and inertia that its maker states"
        )
    for joint in joints:
        if reason := _unphysical(model.inertias[joint]):
            raise ValueError(f"links {links[joint]}, which move together, {reason}")
    if weakest := _massless_joint(model, data):
        raise ValueError(
            f"links {links[weakest]} turn without inertia: the mass matrix is not positive "
            f"definite at joint {model.names[weakest]!r}"
        )


def _require_numbers(link: str, inertial: ElementTree.Element) -> None:
    """Refuse an `<inertial>` that Pinocchio's reader would leave out, or a negative mass."""
    mass, moments, origin = (inertial.find(name) for name in ("mass", "inertia", "origin"))
    if mass is None or moments is None:
        raise ValueError(f"<inertial> of link {link!r} must have <mass> and <inertia>")
    texts = [mass.get("value", ""), *(moments.get(name, "") for name in MOMENTS)]
    texts += ("0 0 0" if origin is None else origin.get("xyz", "0 0 0")).split()
    numbers = list(map(number, texts))
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"<inertial> of link {link!r} must have finite numbers, not {texts}")
    if numbers[0] < 0.0:
        raise ValueError(f"mass {numbers[0]:g} kg of link {link!r} must not be negative")


def _unphysical(inertia: pin.Inertia) -> str:
    """Why these are mass and moments of no body; empty if they may be."""
    distance = float(np.linalg.norm(inertia.lever))
    if distance > LEVER_MAX:
        return f"have their centre of mass {distance:.3g} m from their joint, limit {LEVER_MAX:g}"
    least, middle, largest = np.linalg.eigvalsh(inertia.inertia).tolist()
    text = f"have the principal moments of inertia {least:.3g}, {middle:.3g}, {largest:.3g} kg m^2"
    if least < -NEGATIVE_SHARE * largest - ROUNDING:
        return f"{text}, which must not be negative"
    if largest > least + middle + TRIANGLE_SHARE * largest + ROUNDING:
        return f"{text}: none may exceed the sum of the others"
    return ""


def _massless_joint(model: pin.Model, data: pin.Data) -> int:
    """Number from 1 of a joint that moves without inertia at some posture, or 0."""
    low = np.maximum(model.lowerPositionLimit, -math.pi)
    high = np.minimum(model.upperPositionLimit, math.pi)
    for k in range(_POSTURES):  # spread over the ranges of the joints
        q = low + (0.618 * k + 0.414 * k * np.arange(low.size)) % 1.0 * (high - low)
        mass = pin.crba(model, data, q)
        diagonal = mass.diagonal()
        if diagonal.min() <= 0.0:
            return 1 + int(diagonal.argmin())
        scale = 1.0 / np.sqrt(diagonal)
        values, vectors = np.linalg.eigh(mass * np.outer(scale, scale))
        if values[0] < EIGENVALUE_MIN:
            return 1 + int(np.abs(vectors[:, 0]).argmax())
    return 0


def number(text: str) -> float:
    """Read a number; NaN if it is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan
