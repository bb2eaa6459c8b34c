# SPDX-License-Identifier: Apache-2.0
"""Arms as shapes for drawing."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from wam_power_ros import rotations
from wam_power_ros.control.arm import Arm
from wam_power_ros.view.skeleton import Skeleton

URDF = Path(__file__).resolve().parents[2] / "urdf"
WAM, COBOT = (URDF / "wam7.urdf").read_text(), (URDF / "cobot7.urdf").read_text()
NAMES = tuple(f"wam_j{i}" for i in range(1, 8))
Q = np.array([0.3, -0.6, 0.2, 1.8, -0.4, 0.7, 1.1])


def test_the_tool_is_drawn_where_the_controller_has_it() -> None:
    position, rotation = Arm(WAM, NAMES).tool_pose(Q)
    positions, quats = Skeleton(WAM).placements(Q)
    np.testing.assert_allclose(positions[-1], position, atol=1e-12)
    np.testing.assert_allclose(rotations.matrix(np.roll(quats[-1], -1)), rotation, atol=1e-12)


def test_a_joint_that_turns_without_end_is_drawn_at_its_one_angle() -> None:
    turning = '<joint name="wam_j7" type="continuous">'
    urdf = re.sub('<joint name="wam_j7" type="revolute">', turning, WAM)
    assert turning in urdf
    for text in (urdf, re.sub(f"({turning}.*?)<limit[^>]*>", r"\1", urdf, flags=re.DOTALL)):
        for drawn, expected in zip(
            Skeleton(text).placements(Q), Skeleton(WAM).placements(Q), strict=True
        ):
            np.testing.assert_allclose(drawn, expected, atol=1e-12)


@pytest.mark.parametrize("urdf", [WAM, COBOT])
def test_every_shape_of_the_urdf_is_drawn_and_a_mesh_is_left_out(urdf: str) -> None:
    count, mesh = urdf.count("<visual>"), '<geometry><mesh filename="no.stl"/></geometry>'
    assert len(Skeleton(urdf).shapes) == count
    assert len(Skeleton(re.sub("<geometry>.*?</geometry>", mesh, urdf, count=1)).shapes) < count


def test_joints_that_are_not_named_stay_at_zero() -> None:
    few, all_of_them = Skeleton(WAM, NAMES[:3]), Skeleton(WAM)
    at_zero = all_of_them.placements(np.r_[Q[:3], np.zeros(4)])
    np.testing.assert_allclose(few.placements(Q[:3])[0], at_zero[0])


@pytest.mark.parametrize(
    ("urdf", "names", "said"),
    [("no xml", None, "no URDF"), (WAM, ("elbow",), r"\['elbow'\] are not in .*wam_j1")],
)
def test_an_invalid_urdf_is_refused(urdf: str, names: tuple[str, ...] | None, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Skeleton(urdf, names)
