# SPDX-License-Identifier: Apache-2.0
"""Identity of the arm of a recording or a policy, so that no other arm executes it.

Two arms are the same if their joints have the same axes and the tool is mounted in the same place;
joint names depend on the driver. Masses are not compared: a better identified payload does not make
another arm, and a policy is simulated on the current model before it is executed.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import NamedTuple

from wam_power_ros import plain_json

JOINTS_MAX = 16  # largest number of joints
_NAME = re.compile(r"[^\x00-\x1f]{0,255}")
_DIGEST = re.compile(r"[0-9a-f]{64}")


class ArmIdentity(NamedTuple):
    """Identity of an arm: name, joint names, digests of kinematics and dynamics."""

    name: str  # of the robot, for messages only
    joint_names: tuple[str, ...]  # in the URDF, from base to tip
    kinematics: str  # SHA-256 of the joint axes and the tool's pose at zero, rounded to 0.1 mm
    dynamics: str  # SHA-256 of the masses and inertias of the links, rounded to four digits

    def __str__(self) -> str:
        """Return the name, the joints and the first digits of the kinematics."""
        joints = f"{self.joint_names[0]} to {self.joint_names[-1]}"
        return f"{self.name or 'an arm'} ({joints}, kinematics {self.kinematics[:8]})"


def identity_of(data: object) -> ArmIdentity:
    """Parse an identity from JSON data, as `ArmIdentity._asdict` returns it.

    Raises:
        ValueError: If the data is not an identity; the message names the defect.
    """
    if not isinstance(data, Mapping) or set(data) != set(ArmIdentity._fields):
        raise ValueError(f"an arm's identity must have the keys {', '.join(ArmIdentity._fields)}")
    names = data["joint_names"]
    if not isinstance(names, list | tuple) or not 1 <= len(names) <= JOINTS_MAX:
        raise ValueError(f"joint_names of an arm must be 1 to {JOINTS_MAX} names")
    texts = {_NAME: (data["name"], *names), _DIGEST: (data["kinematics"], data["dynamics"])}
    for rule, values in texts.items():
        for value in values:
            if not isinstance(value, str) or not rule.fullmatch(value):
                raise ValueError(f"{str(value)[:80]!r} of an arm's identity must be {rule.pattern}")
    return ArmIdentity(data["name"], tuple(names), data["kinematics"], data["dynamics"])


def to_json(arm: ArmIdentity | None) -> str:
    """Return an identity as JSON text; empty for None."""
    return "" if arm is None else json.dumps(arm._asdict())


def from_json(text: str) -> ArmIdentity | None:
    """Parse the text of `to_json`.

    Raises:
        ValueError: If the text is not an identity.
    """
    return identity_of(plain_json.parse(text, "identity of an arm")) if text else None


def refusal(theirs: ArmIdentity | None, ours: ArmIdentity | None) -> str:
    """Return why a recording or policy of arm `theirs` must not be used on arm `ours`.

    The text is empty if both are the same arm, or one of them is unknown.
    """
    if theirs is None or ours is None:
        return ""
    same = len(theirs.joint_names) == len(ours.joint_names)
    if same and theirs.kinematics == ours.kinematics:
        return ""
    return f"belongs to another arm: {theirs}; this arm is {ours}"


def remark(theirs: ArmIdentity | None, ours: ArmIdentity) -> str:
    """Return a remark for the log on a recording or policy that is not refused; may be empty."""
    if theirs is None:
        return f"does not name its arm; it is assumed to be {ours}"
    if theirs.dynamics != ours.dynamics:
        return f"was made with other masses in the model of {ours}"
    return ""
