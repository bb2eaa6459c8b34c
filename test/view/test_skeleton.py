# SPDX-License-Identifier: Apache-2.0
"""Arms as shapes for drawing."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from wam_power_ros import rotations
from wam_power_ros.control.arm import Arm
from wam_power_ros.view.skeleton import STICK_RADIUS, Skeleton

URDF = Path(__file__).resolve().parents[2] / "urdf"
WAM, COBOT = (URDF / "wam7.urdf").read_text(), (URDF / "cobot7.urdf").read_text()
NAMES = tuple(f"wam_j{i}" for i in range(1, 8))
Q = np.array([0.3, -0.6, 0.2, 1.8, -0.4, 0.7, 1.1])


def test_the_tool_is_drawn_where_the_controller_has_it() -> None:
    position, rotation = Arm(WAM, NAMES).tool_pose(Q)
    skeleton = Skeleton(WAM)
    positions, quats = skeleton.placements(Q)
    assert skeleton.tool == "pan" and skeleton.joint_names == NAMES
    np.testing.assert_allclose(positions[-1], position, atol=1e-12)
    np.testing.assert_allclose(rotations.matrix(np.roll(quats[-1], -1)), rotation, atol=1e-12)
    np.testing.assert_allclose(skeleton.tool_path(Q[None]), [position], atol=1e-12)


@pytest.mark.parametrize("urdf", [WAM, COBOT])
def test_every_shape_of_the_urdf_is_drawn_on_a_link(urdf: str) -> None:
    skeleton = Skeleton(urdf)
    assert len(skeleton.shapes) == urdf.count("<visual>")
    assert {shape.link for shape in skeleton.shapes} <= set(skeleton.links)
    assert all(min(shape.size) > 0.0 for shape in skeleton.shapes)


def test_a_shape_has_the_colour_of_its_material() -> None:
    pan = [shape for shape in Skeleton(WAM).shapes if shape.link == "pan"]
    assert {shape.rgb for shape in pan} == {(31, 31, 33)}


def test_an_arm_without_shapes_is_drawn_as_sticks_from_link_to_link() -> None:
    skeleton = Skeleton(re.sub(r"<visual>.*?</visual>", "", WAM, flags=re.DOTALL))
    positions, _ = skeleton.placements(np.zeros(7))
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    drawn = [shape.size[1] for shape in skeleton.shapes]
    np.testing.assert_allclose(drawn, lengths[lengths > STICK_RADIUS])


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
