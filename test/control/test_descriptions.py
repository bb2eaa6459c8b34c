# SPDX-License-Identifier: Apache-2.0
"""Descriptions as makers and exporters publish them are read as urdfdom reads them."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import ROOT

from hardware_sim import scene
from wam_power_ros.control.arm import Arm
from wam_power_ros.view.skeleton import Skeleton

URDF = (ROOT / "urdf/cobot7.urdf").read_text()
NAMES = tuple(f"cobot_joint{joint}" for joint in range(1, 8))
BODY = URDF.split("?>", 1)[1]


def cobot(urdf: str, tool: str = "cobot_pan") -> Arm:
    return Arm(urdf, NAMES, tool)


PUBLISHED = {
    "a prefix that is not declared": URDF.replace("<limit ", '<limit lab:acceleration="2.5" '),
    "an element with one": URDF.replace("</robot>", '<sensor:camera name="x"/></robot>'),
    "a default namespace": URDF.replace("<robot ", '<robot xmlns="http://www.ros.org" '),
    "a declared prefix": URDF.replace("<robot ", '<robot xmlns:xacro="http://ros.org" '),
    "an encoding that is declared": f'<?xml version="1.0" encoding="ISO-8859-1"?><!-- ü -->{BODY}',
    "a link with the name of a joint": URDF.replace('"cobot_link3"', '"cobot_joint4"'),
}


@pytest.mark.parametrize("what", PUBLISHED)
def test_an_arm_is_the_same_with(what: str) -> None:
    urdf = PUBLISHED[what]
    assert cobot(urdf).guarded == ()  # those of the WAM are by default its own
    assert cobot(urdf).identity() == cobot(URDF).identity()
    assert len(Skeleton(urdf).joint_names) == 7
    assert len(scene.arm(urdf, NAMES).joints) == 7


@pytest.mark.parametrize(
    ("soft", "kept"),
    [
        ('soft_lower_limit="-0.5" soft_upper_limit="0.4"', (-0.5, 0.4)),
        ('soft_lower_limit="-9" soft_upper_limit="0.4"', (None, 0.4)),
        ('soft_lower_limit="0" soft_upper_limit="0"', (None, None)),
    ],
)
def test_a_joint_stays_within_its_soft_limits(
    soft: str, kept: tuple[float | None, float | None]
) -> None:
    joint = f'<joint name="{NAMES[2]}" type="revolute">'
    assert joint in URDF
    safety = f'<safety_controller k_velocity="1" {soft}/>'
    arm, plain = cobot(URDF.replace(joint, joint + safety)), cobot(URDF)
    for found, usual, bound in zip(
        (arm.q_min, arm.q_max), (plain.q_min, plain.q_max), kept, strict=True
    ):
        expected = usual.copy()
        expected[2] = usual[2] if bound is None else bound
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('<mujoco model="so100"><worldbody/></mujoco>', "begins with <mujoco> of MuJoCo"),
        ("<html><body>404</body></html>", "begins with <html>"),
        ("", "no element found"),
        (URDF[:2000], "not a URDF"),
    ],
)
def test_what_is_no_urdf_is_refused_by_what_it_is(text: str, why: str) -> None:
    for reader in (cobot, Skeleton, scene.arm):
        with pytest.raises(ValueError, match=why):
            reader(text)
