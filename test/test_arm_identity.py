# SPDX-License-Identifier: Apache-2.0
"""Arms are identified by their kinematics, whatever their joints are called."""

from __future__ import annotations

import json

import pytest

from wam_power_ros import arm_identity
from wam_power_ros.arm_identity import ArmIdentity, refusal, remark

OURS = ArmIdentity("wam7", ("wam_j1", "wam_j2"), "1" * 64, "2" * 64)
THEIRS = ArmIdentity("cobot7", ("cobot_joint1", "cobot_joint2"), "a" * 64, "b" * 64)


@pytest.mark.requirement("S-59")
def test_the_refusal_of_another_arm_names_both() -> None:
    said = refusal(THEIRS, OURS)
    assert "cobot7 (cobot_joint1 to cobot_joint2" in said and "wam7 (wam_j1 to wam_j2" in said


@pytest.mark.requirement("S-59")
def test_the_same_arm_and_an_unknown_one_are_not_refused_but_remarked() -> None:
    renamed = OURS._replace(name="left", joint_names=("left_j1", "left_j2"))
    heavier = OURS._replace(dynamics="3" * 64)
    for theirs, said in (
        (OURS, ""),
        (renamed, ""),
        (heavier, "other masses"),
        (None, "does not name its arm; it is assumed to be wam7"),
    ):
        assert refusal(theirs, OURS) == ""
        assert arm_identity.from_json(arm_identity.to_json(theirs)) == theirs
        assert said in remark(theirs, OURS) and bool(said) == bool(remark(theirs, OURS))
    assert refusal(OURS, None) == ""
    assert refusal(OURS._replace(joint_names=("wam_j1",)), OURS)  # fewer joints


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"kinematics": "1" * 63}, "must be"),
        ({"name": "two\nlines"}, "must be"),
        ({"joint_names": []}, "1 to 16 names"),
        ({"joint_names": [1]}, "must be"),
        ({"size": 3}, "must have the keys"),
    ],
)
def test_what_is_no_identity_is_refused(change: dict, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        arm_identity.from_json(json.dumps(OURS._asdict() | change))
    with pytest.raises(ValueError, match="must have the keys"):
        arm_identity.from_json("[]")
