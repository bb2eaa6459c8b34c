# SPDX-License-Identifier: Apache-2.0
"""Which arm a recording or a policy is of, so that another arm never moves by it.

Two arms are the same if their joints turn about the same axes and carry the tool at the same place;
joints have other names under other drivers. Masses do not decide: a payload that was identified
better makes no other arm, and a policy is simulated on the present model before it is executed.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import NamedTuple

JOINTS_MAX = 16
_NAME = re.compile(r"[^\x00-\x1f]{0,255}")
_DIGEST = re.compile(r"[0-9a-f]{64}")


class ArmIdentity(NamedTuple):
    """What tells one arm from another.

    Attributes:
        name: Name of the robot, for people.
        joint_names: Names of its joints in the URDF, base to tip.
        kinematics: SHA-256 of the joint axes and the tool's pose at zero, rounded to 0.1 mm.
        dynamics: SHA-256 of the masses and inertias of its links, rounded to four digits.
    """

    name: str
    joint_names: tuple[str, ...]
    kinematics: str
    dynamics: str

    def __str__(self) -> str:
        """Name, joints and the first digits of the kinematics."""
        joints = f"{self.joint_names[0]} to {self.joint_names[-1]}"
        return f"{self.name or 'an arm'} ({joints}, kinematics {self.kinematics[:8]})"


def identity_of(data: object) -> ArmIdentity:
    """Read an identity from the mapping that `ArmIdentity._asdict` gives, as JSON keeps it.

    Raises:
        ValueError: It is none; names what is wrong.
    """
    if not isinstance(data, Mapping) or set(data) != set(ArmIdentity._fields):
        raise ValueError(f"an arm is identified by {', '.join(ArmIdentity._fields)}")
    names = data["joint_names"]
    if not isinstance(names, list | tuple) or not 1 <= len(names) <= JOINTS_MAX:
        raise ValueError(f"joint_names of an arm must be 1 to {JOINTS_MAX} names")
    for rule, values in (
        (_NAME, (data["name"], *names)),
        (_DIGEST, (data["kinematics"], data["dynamics"])),
    ):
        for value in values:
            if not isinstance(value, str) or not rule.fullmatch(value):
                raise ValueError(f"{str(value)[:80]!r} of an arm's identity must be {rule.pattern}")
    return ArmIdentity(data["name"], tuple(names), data["kinematics"], data["dynamics"])


def to_json(arm: ArmIdentity | None) -> str:
    """Text of an identity; empty for None."""
    return "" if arm is None else json.dumps(arm._asdict())


def from_json(text: str) -> ArmIdentity | None:
    """Read the text of `to_json`.

    Raises:
        ValueError: It is none.
    """
    return identity_of(json.loads(text)) if text else None


def refusal(theirs: ArmIdentity | None, ours: ArmIdentity | None) -> str:
    """Why something of one arm is not for another, naming both; empty if it is, or unknown."""
    if theirs is None or ours is None:
        return ""
    same = len(theirs.joint_names) == len(ours.joint_names)
    if same and theirs.kinematics == ours.kinematics:
        return ""
    return f"is of another arm: of {theirs}; this one is {ours}"


def remark(theirs: ArmIdentity | None, ours: ArmIdentity) -> str:
    """What is worth a line of the log about something that is not refused; may be empty."""
    if theirs is None:
        return f"does not say which arm it is of; it is taken to be {ours}"
    if theirs.dynamics != ours.dynamics:
        return f"was made when {ours} had other masses in its model"
    return ""
