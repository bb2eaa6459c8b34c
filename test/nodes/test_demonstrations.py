# SPDX-License-Identifier: Apache-2.0
"""Bags that can be read, fitted and executed become candidates; the others are named."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from bag_samples import demonstration
from conftest import ROOT

from wam_power_ros import installed
from wam_power_ros.bags import reader
from wam_power_ros.nodes.demonstrations import Demonstrations
from wam_power_ros.nodes.learner import LearnerParams
from wam_power_ros.params import overlay
from wam_power_ros.params.simulated_arm import SimulatedArm
from wam_power_ros.practice.settings import preset

PARAMS = LearnerParams.from_setup(overlay.from_files([]))
BAG = str(min((ROOT / "bags").glob("demo_*")))
SETTINGS = preset("flip")


def arm_of(params: LearnerParams) -> SimulatedArm:
    model = params.urdf, params.model_joint_names, params.tool_frame
    return SimulatedArm(*model, params.controller, str)


def of_arm(arm: SimulatedArm) -> Demonstrations:
    log = logging.getLogger("test")
    return Demonstrations(installed.task_type("flip"), arm, PARAMS.joint_names, log)


@pytest.fixture(scope="module")
def arm() -> SimulatedArm:
    return arm_of(PARAMS)


@pytest.fixture
def demonstrations(arm: SimulatedArm) -> Demonstrations:
    return of_arm(arm)


def test_what_cannot_be_read_is_left_out_and_the_others_keep_their_numbers(
    demonstrations: Demonstrations, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    nothing = str(tmp_path / "nothing")
    bags, read, candidates = demonstrations.candidates(SETTINGS, [nothing, BAG])
    assert bags == [BAG]
    assert len(read) == 1
    assert [policy.id for policy in candidates] == ["demonstration-2"]
    assert [record.getMessage() for record in caplog.records if nothing in record.getMessage()]


def test_what_a_pause_cuts_off_is_logged_with_what_to_do(
    demonstrations: Demonstrations, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    demonstrations.read(BAG)
    assert "left out" not in caplog.text
    _, once = reader.read_demonstration(BAG, PARAMS.joint_names)
    back = np.concatenate([once, np.tile(once[-1], (200, 1)), once[::-1]])
    twice = demonstration(tmp_path / "demo_twice", back, tuple(PARAMS.joint_names))
    assert demonstrations.read(str(twice)).left_out
    (record,) = [each for each in caplog.records if "left out" in each.getMessage()]
    assert record.levelname == "WARNING" and str(twice) in record.getMessage()
    assert "a pause of" in record.getMessage() and "of their own" in record.getMessage()


@pytest.mark.parametrize("bags", [[], ["nothing"]])
def test_a_session_without_a_usable_bag_is_refused(
    demonstrations: Demonstrations, bags: list[str]
) -> None:
    with pytest.raises(ValueError, match=bags[0] if bags else "at least one bag"):
        demonstrations.candidates(SETTINGS, bags)


@pytest.mark.requirement("S-31")
def test_a_demonstration_whose_reproduction_would_end_in_a_fault_is_not_reproduced(
    tmp_path: Path,
) -> None:
    low = tmp_path / "low.yaml"
    low.write_text("torque_controller: {ros__parameters: {tool_speed_max: 0.5}}")
    slow = LearnerParams.from_setup(overlay.from_files([low]))
    with pytest.raises(ValueError, match=f"{BAG}: would end in a fault: tool"):
        of_arm(arm_of(slow)).candidates(SETTINGS, [BAG])


@pytest.mark.parametrize(("springs", "count"), [(0, 8), (16, 16)])
def test_a_policy_has_the_springs_that_the_session_asks_for(
    springs: int, count: int, demonstrations: Demonstrations
) -> None:
    _, _, (policy,) = demonstrations.candidates(preset("flip", springs=springs), [BAG])
    assert policy.basis.count == count
    assert np.linalg.eigvalsh(policy.stiffness).max() == pytest.approx(500.0 * count / 8)
