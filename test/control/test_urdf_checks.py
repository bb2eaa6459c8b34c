# SPDX-License-Identifier: Apache-2.0
"""Joints that an arm cannot have are refused by name, with the remedy; others are locked."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import ROOT

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.corrections import Corrections

URDF = (ROOT / "urdf/ur5e.urdf").read_text()
NAMES = (
    *("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"),
    *("wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
)
LIMIT = (
    'lower="-3.141592653589793" upper="3.141592653589793" effort="150" velocity="3.141592653589793"'
)
ELBOW = '<joint name="elbow_joint" type="revolute">'


def ur(urdf: str, names: tuple[str, ...] = NAMES) -> Arm:
    return Arm(urdf, names, "pan", guarded=())


def finger(name: str, kind: str = "prismatic", inside: str = "") -> str:
    """Joint of a gripper, with its link, on the flange."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="wrist_3_link"/>'
        f'<child link="{name}_link"/>'
        f'<axis xyz="0 0 1"/>{inside}<limit lower="0" upper="1" effort="1" velocity="1"/></joint>'
        f'<link name="{name}_link"/></robot>'
    )


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            ELBOW,
            ELBOW.replace("revolute", "continuous"),
            "'elbow_joint' is continuous: .* in position_limits",
        ),
        (ELBOW, ELBOW.replace("revolute", "fixed"), "'elbow_joint' is fixed .* movable are"),
        (ELBOW, ELBOW.replace("revolute", "floating"), "'elbow_joint' is of type 'floating'"),
        (ELBOW, f'{ELBOW}<mimic joint="wrist_1_joint"/>', "'elbow_joint' mimics .* leave it out"),
        (LIMIT, LIMIT.partition(" effort")[0], "'elbow_joint' has no limit 'velocity'"),
        (LIMIT, LIMIT.replace("150", "0"), "effort = '0' of .* a finite number above 0"),
        (LIMIT, LIMIT.replace("150", "inf"), "effort = 'inf' of joint 'elbow_joint' must be a fin"),
        (LIMIT, LIMIT.replace('"-3', '"4'), "upper = '3.* of .* number above 4"),
    ],
)
def test_a_joint_that_an_arm_cannot_have_is_named_with_the_remedy(
    old: str, new: str, words: str
) -> None:
    assert URDF.count(old) == 1
    with pytest.raises(ValueError, match=words):
        ur(URDF.replace(old, new))


def test_the_fingers_of_a_gripper_are_locked_whatever_their_kind() -> None:
    plain = ur(URDF)
    q = np.linspace(-1.0, 1.0, 6)
    mimic = finger("other", inside='<mimic joint="finger"/>')
    eight = URDF.replace("</robot>", finger("finger")).replace("</robot>", mimic)
    for urdf in (
        eight,
        *(URDF.replace("</robot>", finger("f", k)) for k in ("continuous", "fixed")),
    ):
        arm = ur(urdf)
        assert arm.n == 6
        assert np.allclose(arm.gravity(q), plain.gravity(q))
    with pytest.raises(ValueError, match=r"joints \['thumb'\] are not in .* known: .*'finger'"):
        ur(eight, (*NAMES, "thumb"))
    with pytest.raises(ValueError, match=r"base to tip, \('shoulder_pan_joint', 'shoulder_lift_jo"):
        ur(URDF, tuple(sorted(NAMES)))
    coupled = finger("rod", "revolute", '<mimic joint="elbow_joint"/>')
    with pytest.raises(ValueError, match="'rod' mimics 'elbow_joint' of the arm"):
        ur(URDF.replace("</robot>", coupled))


def test_position_limits_make_a_continuous_joint_usable_and_tighten_others() -> None:
    limits = [0.0, 0.0, -2.0, 0.5, -3.0, 3.0, *[0.0] * 6]
    plain, urdf = ur(URDF), URDF.replace(ELBOW, ELBOW.replace("revolute", "continuous"))
    arm = Arm(urdf, NAMES, "pan", guarded=(), position_limits=limits)
    for given, found in ((plain.q_min, arm.q_min), (plain.q_max, arm.q_max)):
        np.testing.assert_array_equal(given[[0, 3, 4, 5]], found[[0, 3, 4, 5]])
    assert arm.q_min[1:3].tolist() == [-2.0, -3.0]
    assert arm.q_max[1:3].tolist() == [0.5, 3.0]
    assert arm.identity() == plain.identity()
    corrected = arm.corrected(Corrections.from_values(6, zeros=[0.1, *[0.0] * 5]))
    assert corrected.q_max[2] == 3.0


@pytest.mark.parametrize(
    ("joint", "limits", "words"),
    [
        ("revolute", (-7.0, 1.0), "'elbow_joint', -7 to 1, .* those of the URDF, -3.14159 to 3.1"),
        ("revolute", (1.0, 1.0), "'elbow_joint', 1 to 1, must rise"),
        ("continuous", (-3.2, 3.2), "'elbow_joint', -3.2 to 3.2, .* within a turn"),
        ("revolute", (1.0,) * 9, "must be 12 numbers"),
    ],
)
def test_position_limits_beyond_those_of_the_maker_are_refused(
    joint: str, limits: tuple[float, ...], words: str
) -> None:
    urdf = URDF.replace(ELBOW, ELBOW.replace("revolute", joint))
    given = [0.0] * 4 + [*limits] + [0.0] * 6
    with pytest.raises(ValueError, match=words):
        Arm(urdf, NAMES, "pan", guarded=(), position_limits=given)
