# SPDX-License-Identifier: Apache-2.0
"""Flip task: readiness, stopping rule and the outcome in tables."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from wam_power_ros import rotations
from wam_power_ros.params import overlay
from wam_power_ros.params.body_tracker_params import BodyTrackerParams
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.settings import TRUE_TURN
from wam_power_ros.tasks.flip.task import Flip
from wam_power_ros.tasks.task import Pose
from wam_power_ros.tracking.tracker import Tracker

FLIP = Flip(preset("flip").task_settings, {})
PAN = Pose(np.array([0.6, -0.1, 0.9]), rotations.exp(np.array([0.3, 0.2, 0.0])))  # tilted


def ready(in_pan: list[float], speed: float = 0.0) -> str:
    position = PAN.position + PAN.rotation @ np.array(in_pan)
    velocity, turn = np.array([0.0, speed, 0.0]), np.array([0.0, 0.001, 0.0])
    state = SimpleNamespace(position=position, velocity=velocity, angular_velocity=turn)
    return FLIP.ready(state, PAN)


@pytest.mark.parametrize(
    ("in_pan", "speed", "words"),
    [
        ([0.065, 0.0, 0.003], 0.0, ""),
        ([0.0, 0.0, 0.026], 0.049, ""),
        ([0.08, 0.08, 0.003], 0.0, "not in the pan: 0.080, 0.080, 0.003 m"),
        ([0.0, 0.0, -0.025], 0.0, "at rest -25 mm from the pan's floor"),
        ([0.03, 0.07, 0.003], 0.0, "flat 76 mm beside the middle of the pan"),
        ([0.0, 0.0, 0.03], 0.0, "at rest +30 mm from the pan's floor, where nothing can hold it"),
        ([0.0, 0.0, 0.03], 0.06, "not in the pan"),
        ([0.082, 0.007, 0.022], 0.0, "lies on the rim of the pan, 22 mm above its floor"),
        ([0.0, 0.0, 0.003], 0.06, "moves at 0.06 m/s"),
    ],
)
def test_a_rollout_begins_when_the_pancake_rests_in_the_tilted_pan(
    in_pan: list[float], speed: float, words: str
) -> None:
    answer = ready(in_pan, speed)
    assert words in answer and bool(words) == bool(answer)
    assert FLIP.ready(None, PAN) == "the pancake is not seen"


@pytest.mark.parametrize("single_marker", [True, False])
def test_a_rollout_does_not_begin_with_one_marker_on_the_pancake(single_marker: bool) -> None:
    made = overlay.setup().changed({"pancake_tracker": {"single_marker": single_marker}})
    tracker, rng = Tracker(BodyTrackerParams.from_setup(made)), np.random.default_rng(0)
    rest = PAN.position + PAN.rotation @ np.array([0.0, 0.0, 0.0025])
    for number in range(12):
        place, turn = rest + rng.normal(0.0, 0.00025, 3), rng.normal(0.0, 0.0035, 3)
        seen = tracker.add(10**9 + number * 33_333_333, place, rotations.quat_of_vector(turn))
    assert ("one marker" in FLIP.ready(seen, PAN)) is single_marker


def judged(observation: dict[str, Any] | None, **fields: object) -> SimpleNamespace:
    rest = {"kind": "retest", "fault": "", "why": "", "truth": None, "observation": observation}
    return SimpleNamespace(**(rest | fields))


def test_one_window_of_rotation_holds_for_success_and_ground_truth() -> None:
    settings = preset("flip").task_settings
    window = np.rad2deg([settings.success_angle, settings.success_angle_max])
    np.testing.assert_allclose(window, TRUE_TURN)
    with pytest.raises(ValueError, match="no rotation is a success"):
        preset("flip", success_angle_max=2.5)


def test_a_table_says_how_far_the_pancake_turned_and_where_it_ended() -> None:
    for angle, flipped, resting, cell in (
        (3.0, True, True, "172° flipped,"),
        (2.0, True, True, "115° turned o"),
        (-3.0, True, False, "172° dropped"),
    ):
        seen = {"tossed": True, "angle": angle, "flipped": flipped, "resting": resting}
        assert FLIP.outcome(judged(seen)).startswith(cell)
    assert FLIP.outcome(judged({"tossed": False, "resting": False})) == "not tossed, dropped"


def test_a_summary_counts_the_re_tests_and_the_truth_of_those_that_have_one() -> None:
    caught = {"flipped": True, "resting": True, "angle": 3.0}
    dropped = {**caught, "resting": False}
    truth = {"caught": True, "flipped": True, "true_flip": False}
    records = [judged(caught, truth=truth), judged(dropped, truth={**truth, "caught": False})]
    records += [judged(caught, kind="trial", truth=truth), judged(None)]
    seen, true = FLIP.summary(records)
    assert seen.startswith("re-tests of the final policy: 1 of 3 flipped")
    assert true.startswith(
        "simulator's ground truth: 0 of 2 flipped (150 to 240 degrees in the air"
    )
    assert true.endswith("; 1 more turned over and caught")
    assert FLIP.summary(records[2:3]) == []
