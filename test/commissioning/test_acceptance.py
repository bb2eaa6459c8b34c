# SPDX-License-Identifier: Apache-2.0
"""What may be used and what not: every value has a range, and NaN is in none."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import true_arm

from wam_power_ros import rotations
from wam_power_ros.commissioning.acceptance import Finding, notes, refusals
from wam_power_ros.commissioning.camera_frame import Pose
from wam_power_ros.commissioning.measurement import Commissioned

ARM = true_arm.plain()
FLAT = Pose(np.zeros(3), rotations.exp(np.array([0.0, 0.0, 0.3])))
BY_FLAT = "zero of wam_j7, by --flat"


@pytest.fixture(scope="module")
def ordinary() -> Commissioned:
    return true_arm.commissioned()


def changed(found: Commissioned, **values: Any) -> Commissioned:  # noqa: ANN401 - of any kind
    """The result with other values: of the frame, the cameras, the corrections, or the arm."""
    assert found.cameras is not None
    seen, arm = found.cameras, found.arm
    parts = {
        part: {name: value for name, value in values.items() if hasattr(part, name)}
        for part in (seen.frame, seen, arm.corrections, arm, found)
    }
    frame, corrections = (replace(part, **parts[part]) for part in (seen.frame, arm.corrections))
    seen = replace(seen, **{"frame": frame} | parts[seen])
    arm = replace(arm, **{"corrections": corrections} | parts[arm])
    return replace(found, **{"cameras": seen, "arm": arm} | parts[found])


def quantities(findings: list[Finding]) -> list[str]:
    return [finding.quantity for finding in findings]


@pytest.mark.requirement("S-129")
def test_an_ordinary_arm_is_not_refused(ordinary: Commissioned) -> None:
    assert refusals(ARM, ordinary, 0.0) == []


ZEROS = np.deg2rad([0.0, 0.0, 0.0, 5.1, 0.0, 0.0, 0.0])
REFUSED: list[tuple[dict[str, Any], str, float, str]] = [
    ({"fit_position": 2.1e-3}, "body from its prediction at the rests that were used", 2.1, "fast"),
    ({"fit_rotation": np.deg2rad(0.6)}, "body from its prediction at the rests", 0.6, "0 to 0.5"),
    ({"check_position": 2.1e-3}, "body from its prediction at unused postures", 2.1, "0 to 2"),
    ({"check_rotation": np.deg2rad(0.6)}, "body from its prediction at unused", 0.6, "0 to 0.5"),
    ({"sweep_position": 2.1e-3}, "body from its prediction in the sweeps", 2.1, "0 to 2"),
    ({"sweep_rotation": np.deg2rad(0.6)}, "body from its prediction in the sweeps", 0.6, "fasten"),
    ({"zeros": -ZEROS}, "zero of wam_j4", -5.1, "zero the joint anew"),
    ({"zeros": ZEROS[[0, 1, 2, 4, 4, 5, 3]]}, "zero of wam_j7", 5.1, "lay a level"),
    ({"upright": np.deg2rad(6.0)}, "base's z axis to the cameras'", 6.0, "set up_axis"),
    ({"latency": -0.0011}, "delay of the cameras' stamps", -1.1, "-1 to 200.*clocks"),
    ({"latency": 0.201}, "delay of the cameras' stamps", 201.0, "-1 to 200.*clocks"),
    ({"latency_change": -0.0011}, "change of that delay", -1.1, "-1 to 1.*clocks"),
    ({"torque_scales": np.array([1, 1, 0.84, 1, 1, 1, 1])}, "torque of wam_j3", 0.84, "0.85 to"),
    ({"torque_scales": np.array([1, 1, 1, 1, 1, 1, 1.16])}, "torque of wam_j7", 1.16, "to 1.15"),
    ({"felt_payload": 0.3, "felt_sd": 0.03}, "mass of the tool", 0.756, "weigh again"),
]


@pytest.mark.requirement("S-129")
@pytest.mark.parametrize(("values", "quantity", "value", "says"), REFUSED)
def test_a_value_out_of_its_range_is_refused_with_value_range_and_remedy(
    values: dict[str, Any], quantity: str, value: float, says: str, ordinary: Commissioned
) -> None:
    (finding,) = refusals(ARM, changed(ordinary, **values), 0.0)
    assert finding.quantity.startswith(quantity)
    assert finding.value == pytest.approx(value, rel=0.01)
    assert re.search(says, str(finding))


@pytest.mark.requirement("S-129")
def test_a_value_that_could_not_be_measured_is_refused(ordinary: Commissioned) -> None:
    for name in (
        *("upright", "fit_position", "fit_rotation"),
        *("check_position", "check_rotation", "sweep_position", "sweep_rotation"),
        *("latency", "latency_change", "felt_payload"),
    ):
        assert len(refusals(ARM, changed(ordinary, **{name: math.nan}), 0.0)) == 1, name


@pytest.mark.requirement("S-129")
@pytest.mark.parametrize("name", ["rest", "slow", "fast"])
def test_a_torque_that_is_left_unexplained_is_refused(name: str, ordinary: Commissioned) -> None:
    before = replace(ordinary.before, **{name: 0.8})
    for left, refused in ((0.39, 0), (0.41, 1), (math.nan, 1)):
        after = replace(ordinary.after, **{name: left})
        assert len(refusals(ARM, changed(ordinary, before=before, after=after), 0.0)) == refused
    less = replace(ordinary.before, **{name: 0.3})
    after = replace(ordinary.after, **{name: 0.29})  # as little as an ordinary arm may have
    assert refusals(ARM, changed(ordinary, before=less, after=after), 0.0) == []


def test_the_delay_of_the_stamps_counts_from_the_exposure(ordinary: Commissioned) -> None:
    late = changed(ordinary, latency=-0.009)
    assert refusals(ARM, late, latency_offset=0.01) == []
    assert len(refusals(ARM, late, latency_offset=0.0)) == 1


def lying(vector: list[float]) -> Pose:
    """A body on the tool, turned by a rotation vector [degrees]."""
    return Pose(np.zeros(3), rotations.exp(np.deg2rad(vector)) @ FLAT.rotation)


@pytest.mark.requirement("S-129")
def test_a_body_that_is_said_to_lie_flat_and_does_not_is_refused(ordinary: Commissioned) -> None:
    said, tilted = {"zeros_sd": np.full(7, 0.001)}, {"body_in_tool": lying([0.0, 1.1, 0.0])}
    assert refusals(ARM, changed(ordinary, body_in_tool=lying([0.0, 0.9, 0.0]), **said), 0.0) == []
    (finding,) = refusals(ARM, changed(ordinary, **tilted, **said), 0.0)
    assert finding.value == pytest.approx(1.1, abs=1e-3)
    assert "--flat" in finding.advice
    assert refusals(ARM, changed(ordinary, **tilted), 0.0) == []


@pytest.mark.requirement("S-129")
def test_what_is_found_of_the_last_joint_by_a_flat_body_is_always_noted(
    ordinary: Commissioned,
) -> None:
    assert BY_FLAT not in quantities(notes(ARM, ordinary))
    flat = changed(ordinary, zeros_sd=np.full(7, 0.001), zeros=np.deg2rad([0, 0, 0, 0, 0, 0, 0.5]))
    (noted,) = notes(ARM, flat)
    assert noted.quantity == BY_FLAT
    assert noted.value == pytest.approx(0.5)
    assert "turn the body by half a turn" in noted.advice


@pytest.mark.requirement("S-129")
def test_rests_that_were_rejected_or_not_seen_are_noted_by_number(ordinary: Commissioned) -> None:
    left_out = changed(ordinary, rejected=(0, 11), not_visible=(7,), zeros=np.zeros(7))
    rejected, not_visible = notes(ARM, left_out)
    assert (rejected.quantity, rejected.value) == ("rests rejected", 2)
    assert "number 1, 12:" in rejected.advice
    assert (not_visible.quantity, not_visible.value) == ("rests without a body", 1)
    assert "number 8:" in not_visible.advice


def test_that_the_cameras_saw_no_body_is_noted(ordinary: Commissioned) -> None:
    blind = replace(ordinary, cameras=None)
    assert "rests with the body in view" in quantities(notes(ARM, blind))
    assert refusals(ARM, blind, 0.0) == []


@pytest.mark.parametrize(
    ("values", "quantity", "value"),
    [
        ({"zeros": np.deg2rad([0, 0, -2.1, 0, 0, 0, 0])}, "zero of wam_j3", -2.1),
        ({"base_tilt": np.deg2rad([1.5, -1.5])}, "tilt of the base", 2.12),
        ({"payload": np.array([-0.16, 0.0157, 0.0, -0.0004])}, "tool beyond the URDF's", -0.16),
        ({"payload": np.array([0.0, 0.0, 0.03, 0.0])}, "tool's centre to the URDF's", 44.4),
    ],
)
def test_what_is_better_mended_is_noted(
    values: dict[str, Any], quantity: str, value: float, ordinary: Commissioned
) -> None:
    fine = {"zeros": np.zeros(7), "base_tilt": np.zeros(2), "payload": np.zeros(4)}
    assert notes(ARM, changed(ordinary, **fine)) == []
    (noted,) = notes(ARM, changed(ordinary, **(fine | values)))
    assert noted.quantity == quantity
    assert noted.value == pytest.approx(value, rel=0.01)
