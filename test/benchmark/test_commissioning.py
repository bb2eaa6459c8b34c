# SPDX-License-Identifier: Apache-2.0
"""The spoilt laboratories of the benchmark of the commissioning."""

from __future__ import annotations

import numpy as np
import pytest
import true_arm

from benchmark.commissioning import judged, verdict
from benchmark.spoilt_laboratories import SPOILT, Laboratory
from wam_power_ros import rotations
from wam_power_ros.commissioning.acceptance import Finding
from wam_power_ros.commissioning.camera_frame import Pose

ARM = true_arm.plain()
Judged = tuple[dict[str, float], list[str], list[Finding]]  # figures, refusals, notes


@pytest.fixture(scope="module")
def laboratory() -> Laboratory:
    """An ordinary one, with a body that lies flat."""
    plan, true = true_arm.planned(), true_arm.truth()
    flat = Pose(np.array([0.02, -0.01, 0.01]), rotations.exp(np.array([0.0, 0.0, 0.3])))
    made = true_arm.recording(plan, true, mounted=flat)
    return Laboratory(plan, made, float(true.payload[0]))


@pytest.fixture(scope="module")
def ordinary(laboratory: Laboratory) -> Judged:
    """What is found in it."""
    return judged(ARM, laboratory)


@pytest.mark.requirement("S-129")
def test_an_ordinary_laboratory_is_not_refused(ordinary: Judged) -> None:
    figures, refused, noted = ordinary
    assert refused == []
    assert figures["check mm"] < 2.0
    assert "rests rejected" not in {note.quantity for note in noted}


@pytest.mark.requirement("S-129")
@pytest.mark.parametrize("spoil", [*SPOILT][::3])
def test_a_spoilt_laboratory_is_refused_or_noted(
    spoil: str, laboratory: Laboratory, ordinary: Judged
) -> None:
    usual = {note.quantity for note in ordinary[2]}
    _, refused, noted = judged(ARM, SPOILT[spoil](laboratory, np.random.default_rng(0)))
    told = {note.quantity for note in noted} - usual
    assert refused or told


def test_a_laboratory_is_judged_wrongly_if_it_is_spoilt_and_not_told_so() -> None:
    note = Finding("rests rejected", 1, "", "0 to 0", "markers were hidden")
    assert verdict(1, "knocked", {}, [], [])["wrong"]
    assert not verdict(1, "knocked", {}, [], [note])["wrong"]
    assert not verdict(1, "knocked", {}, ["refused"], [])["wrong"]
    assert not verdict(1, "", {}, [], [note])["wrong"]
    assert verdict(1, "", {}, ["refused"], [])["wrong"]
