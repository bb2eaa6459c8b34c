# SPDX-License-Identifier: Apache-2.0
"""Check of a URDF's joints: which of them an arm can have, by name and with the remedy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from xml.etree import ElementTree

_LIMITED = ("revolute", "prismatic")


def require_usable(tree: ElementTree.Element, joint_names: Sequence[str]) -> None:
    """Refuse joints that an arm cannot have; those of the URDF that are not named are locked.

    Args:
        tree: URDF.
        joint_names: Names of the arm's joints.

    Raises:
        ValueError: A joint of the arm is missing, fixed, continuous, mimics another one, or lacks a
            limit, or a joint that is not of the arm mimics one of the arm. It names the joint.
    """
    joints = {joint.get("name", ""): joint for joint in tree.iterfind("./joint")}
    kinds = {name: joint.get("type", "") for name, joint in joints.items()}
    known = [name for name, kind in kinds.items() if kind != "fixed"]
    missing = [name for name in joint_names if name not in joints]
    if missing or not joint_names:
        raise ValueError(f"joints {missing} are not in the robot description; known: {known}")
    for name in joint_names:
        _require_moving(name, joints[name], known)
        _require_limits(name, joints[name])
    for name in set(known) - set(joint_names):
        mimic = joints[name].find("mimic")
        if mimic is not None and (leader := mimic.get("joint")) in joint_names:
            raise ValueError(
                f"joint {name!r} mimics {leader!r} of the arm and would be locked: an arm "
                "is a chain of independent joints; fix it in a URDF of your own"
            )


def _require_moving(name: str, joint: ElementTree.Element, known: list[str]) -> None:
    kind = joint.get("type")
    if kind == "fixed":
        raise ValueError(f"joint {name!r} is fixed in the robot description; movable are {known}")
    if kind == "continuous":
        raise ValueError(
            f"joint {name!r} is continuous: a driver may wrap its positions, which then jump; "
            'give it type="revolute" with limits between which they do not jump, such as '
            'lower="-3.1" upper="3.1"'
        )
    if kind not in _LIMITED:
        raise ValueError(f"joint {name!r} is of type {kind!r}; allowed are {list(_LIMITED)}")
    if (mimic := joint.find("mimic")) is not None:
        text = f"joint {name!r} mimics {mimic.get('joint')!r} and cannot be commanded: leave it out"
        raise ValueError(f"{text} of model_joint_names and joint_names")


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


def number(text: str) -> float:
    """Read a number; NaN if it is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan
