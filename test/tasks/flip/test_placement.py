# SPDX-License-Identifier: Apache-2.0
"""What cameras show must be the pancake in the pan: another body or frame is refused, with why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as some
from simulated_toss import Toss, capture, toss
from toss_task import demonstrated_policy

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.assessment import assess
from wam_power_ros.tasks.flip.placement import doubt, turned
from wam_power_ros.tasks.task import Assessment

POLICY = demonstrated_policy("trial-0001")
SETTINGS = preset("flip").task_settings


def seen(truth: Toss, rng: np.random.Generator) -> tuple[BodyPath, BodyPath]:
    """Frames from the start on, and of the pancake at rest before it."""
    path, t = capture(truth, rng), np.arange(-0.3, -0.01, 1 / 30)
    place = truth.position[0] + rng.normal(0.0, 0.00025, (len(t), 3))
    quat = np.tile(rotations.quat_xyzw(truth.matrix[0]), (len(t), 1))
    return path, BodyPath("t", t, place, quat)


def moved(path: BodyPath, offset: np.ndarray, turn: np.ndarray | None = None) -> BodyPath:
    turn = np.eye(3) if turn is None else turn
    quat = rotations.quat_xyzw(turn @ rotations.matrix(path.quat_xyzw))
    return BodyPath(path.id, path.t, path.position @ turn.T + offset, quat)


def judged(pan: EndEffectorPath, body: BodyPath, before: BodyPath) -> Assessment:
    pan = EndEffectorPath(POLICY.id, pan.t, pan.position, pan.quat_xyzw)
    body = BodyPath(POLICY.id, body.t, body.position, body.quat_xyzw)
    return assess(POLICY, Rollout(pan, body, before=before), SETTINGS)


@settings(max_examples=5, deadline=None, derandomize=True, phases=[Phase.generate])
@given(
    seed=some.integers(0, 1000),
    up=some.floats(-0.02, 0.02),
    along=some.floats(-0.02, 0.02),
    across=some.floats(-0.02, 0.02),
)
def test_cameras_2_cm_off_change_the_landing_by_as_much_and_nothing_else(
    seed: int, up: float, along: float, across: float
) -> None:
    rng = np.random.default_rng(seed)
    truth, off = toss(rng, half_turns=1.0), np.array([along, across, up])
    frames = seen(truth, rng)
    expected = judged(truth.pan, *frames)
    found = judged(truth.pan, *(moved(each, off) for each in frames))
    assert (found.success, found.why) == (expected.success, expected.why)
    names = ("angle", "t_f", "apex", "climb")
    for name, most in zip(names, (0.06, 0.01, 0.008, 0.008), strict=True):
        assert found.observation[name] == pytest.approx(expected.observation[name], abs=most)
    miss = np.subtract(found.observation["landing_error"], expected.observation["landing_error"])
    assert miss[:2] == pytest.approx(off[:2], abs=0.01)


@settings(max_examples=5, deadline=None, derandomize=True, phases=[Phase.generate])
@given(seed=some.integers(0, 1000), degrees=some.floats(8.0, 352.0))
def test_a_turned_frame_shows_the_pancake_where_it_cannot_rest(seed: int, degrees: float) -> None:
    rng = np.random.default_rng(seed)
    truth, turn = toss(rng, half_turns=1.0), rotations.exp([0.0, 0.0, np.deg2rad(degrees)])
    found = judged(truth.pan, *(moved(each, np.zeros(3), turn) for each in seen(truth, rng)))
    assert found.ret is None and found.observation is None
    assert "the cameras' frame is wrong" in found.why


@settings(max_examples=5, deadline=None, derandomize=True, phases=[Phase.generate])
@given(seed=some.integers(0, 1000), late=some.floats(-0.05, 0.15))
def test_a_body_that_stays_while_the_pan_moves_is_another_one(seed: int, late: float) -> None:
    rng = np.random.default_rng(seed)
    truth = toss(rng, half_turns=1.0)
    path, before = seen(truth, rng)
    still = path.position * 0.0 + truth.position[0] + rng.normal(0.0, 0.0003, path.position.shape)
    other = BodyPath("t", path.t, still, path.quat_xyzw)
    assert "the markers are those of another body" in judged(truth.pan, other, before).why
    own = BodyPath("t", path.t + late, path.position, path.quat_xyzw)  # by other clocks
    assert not doubt(truth.pan, own.part(own.t >= 0.0), before)


def test_one_marker_is_named() -> None:
    rng = np.random.default_rng(0)
    truth = toss(rng, half_turns=1.0)
    path, before = (
        replace(each, quat_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (len(each.t), 1)))
        for each in seen(truth, rng)
    )
    assert "as of one marker" in judged(truth.pan, path, before).why


def test_a_pancake_that_does_not_turn_with_the_pan_tells_nothing_of_the_frame() -> None:
    rng = np.random.default_rng(3)
    truth = toss(rng, half_turns=1.0)
    body, before = seen(truth, rng)
    still = BodyPath(
        body.id, body.t, body.position, np.tile(before.quat_xyzw[-1], (len(body.t), 1))
    )
    assert turned(truth.pan, still, before) == ""
    pan = truth.pan
    first = EndEffectorPath(pan.id, pan.t[:1], pan.position[:1], pan.quat_xyzw[:1])
    assert turned(first, body, before) == ""


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("degrees", [-40.0, -15.0, -5.0, 5.0, 15.0, 40.0])
def test_a_frame_that_is_turned_is_refused_by_the_axis_about_which_the_pancake_turns(
    axis: int, degrees: float
) -> None:
    rng = np.random.default_rng(abs(int(degrees)))
    truth = toss(rng, half_turns=1.0)
    turn = rotations.exp(np.deg2rad(degrees) * np.eye(3)[axis])
    offset = truth.position[0] - turn @ truth.position[0]  # it rests in the pan all the same
    why = judged(truth.pan, *(moved(each, offset, turn) for each in seen(truth, rng))).why
    assert why == "" if axis == 2 and abs(degrees) < 10.0 else "frame is turned" in why
    if why:
        told = float(why.split(" degrees off")[0].rsplit(" ", 1)[1])
        assert told == pytest.approx(abs(degrees), abs=3.0)
