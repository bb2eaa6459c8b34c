# SPDX-License-Identifier: Apache-2.0
"""Check of masses and inertias: only an arm of physical bodies can be carried by its model.

Bodies that are fixed to each other count as one: many descriptions have frames without mass, and
sensors or flanges with placeholders, which are harmless beside what they are fixed to.
"""

from __future__ import annotations

import math
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from wam_power_ros.control.urdf_joints import number

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
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def require_physical(tree: ElementTree.Element, model: pin.Model) -> None:
    """Refuse an arm whose moving links are no physical bodies.

    Args:
        tree: URDF.
        model: Chain of the arm's joints, whose other joints are locked; without rotor inertias.

    Raises:
        ValueError: An `<inertial>` cannot be read, what a joint moves has no mass, an inertia is
            that of no body, or the mass matrix is not positive definite. It names the links.
    """
    joints = range(1, model.njoints)
    links = [_links(model, joint) for joint in joints]
    moving = {name for names in links for name in names}
    for link in tree.iterfind("./link"):
        inertial = link.find("inertial")
        if link.get("name") in moving and inertial is not None:
            _require_numbers(link.get("name", ""), inertial)
    masses = [inertia.mass for inertia in model.inertias]
    for joint in reversed(joints):
        masses[model.parents[joint]] += masses[joint]
    without = [name for joint in joints if masses[joint] <= 0.0 for name in links[joint - 1]]
    if without:
        raise ValueError(
            f"links {without} move without mass: each link of an arm needs an <inertial> with the "
            "mass and inertia that its maker states"
        )
    for joint in joints:
        if reason := _unphysical(model.inertias[joint]):
            raise ValueError(f"links {links[joint - 1]}, which move together, {reason}")
    if (weakest := _massless_joint(model)) is not None:
        raise ValueError(
            f"links {links[weakest]} turn without inertia: the mass matrix is not positive "
            f"definite at joint {model.names[weakest + 1]!r}"
        )


def _links(model: pin.Model, joint: int) -> list[str]:
    """Names of the links that are fixed to each other behind a joint."""
    body = pin.FrameType.BODY
    return [each.name for each in model.frames if each.type == body and each.parentJoint == joint]


def _require_numbers(link: str, inertial: ElementTree.Element) -> None:
    """Refuse an `<inertial>` that Pinocchio's reader would leave out, or a negative mass."""
    mass, moments, origin = (inertial.find(name) for name in ("mass", "inertia", "origin"))
    if mass is None or moments is None:
        raise ValueError(f"<inertial> of link {link!r} must have <mass> and <inertia>")
    texts = [mass.get("value", ""), *(moments.get(name, "") for name in _MOMENTS)]
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
    text = f"{least:.3g}, {middle:.3g}, {largest:.3g} kg m^2"
    if least < -NEGATIVE_SHARE * largest - ROUNDING:
        return f"have the principal moments of inertia {text}, which must not be negative"
    if largest > least + middle + TRIANGLE_SHARE * largest + ROUNDING:
        return (
            f"have the principal moments of inertia {text}: none may exceed the sum of the others"
        )
    return ""


def _massless_joint(model: pin.Model) -> int | None:
    """Number from 0 of a joint that moves without inertia at some posture, or None."""
    data = model.createData()
    low = np.maximum(model.lowerPositionLimit, -math.pi)
    high = np.minimum(model.upperPositionLimit, math.pi)
    for k in range(_POSTURES):  # spread over the ranges of the joints
        q = low + (0.618 * k + 0.414 * k * np.arange(low.size)) % 1.0 * (high - low)
        mass = pin.crba(model, data, q)
        diagonal = mass.diagonal()
        if diagonal.min() <= 0.0:
            return int(diagonal.argmin())
        scale = 1.0 / np.sqrt(diagonal)
        values, vectors = np.linalg.eigh(mass * np.outer(scale, scale))
        if values[0] < EIGENVALUE_MIN:
            return int(np.abs(vectors[:, 0]).argmax())
    return None
