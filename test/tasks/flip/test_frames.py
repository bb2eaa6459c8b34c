# SPDX-License-Identifier: Apache-2.0
"""Frames of the pancake relative to the pan: in flight, at rest, normal."""

import math
from dataclasses import replace

import numpy as np
import pytest
from simulated_toss import END, capture, toss, without

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.tasks.flip.frames import (
    PAN_RADIUS,
    PANCAKE_RADIUS,
    Frames,
    frames_from_pan,
)

PAN = np.array([0.6, 0.1, 0.9])
TILT = np.array([0.0, 0.2, 0.0])  # rotation vector of the pan [rad]
NORMAL = rotations.exp(TILT)[:, 2]


def still_pan() -> EndEffectorPath:
    t = np.linspace(0.0, 1.0, 11)
    return EndEffectorPath(
        "t", t, np.tile(PAN, (11, 1)), np.tile(rotations.quat_of_vector(TILT), (11, 1))
    )


def seen_from_still_pan(offsets: list[np.ndarray], edge_on: bool = False) -> Frames:
    """Five frames at rest, then one for each offset from the pan's centre, flat or edge on."""
    offset = np.array([0.003 * NORMAL] * 5 + offsets)
    quat = np.tile(rotations.quat_of_vector(TILT), (len(offset), 1))
    if edge_on:
        quat[5:] = rotations.multiply(quat[5:], rotations.quat_of_vector([math.pi / 2.0, 0.0, 0.0]))
    path = BodyPath("t", np.linspace(0.0, 1.0, len(offset)), PAN + offset, quat)
    return frames_from_pan(still_pan(), path)


def test_height_is_along_the_normal_of_the_tilted_pan_and_aside_along_its_floor() -> None:
    along = rotations.exp(TILT)[:, 0]
    frames = seen_from_still_pan([0.2 * NORMAL + 0.05 * along])
    assert frames.height[-1] == pytest.approx(0.2)
    assert frames.offset[-1] == pytest.approx(0.05)
    assert frames.cosine == pytest.approx(1.0)
    assert frames.resting_frames == 5


@pytest.mark.parametrize(("edge_on", "lowest"), [(False, 0.03), (True, 0.03 + PANCAKE_RADIUS)])
def test_a_pancake_flies_when_its_lower_edge_is_above_the_rim(edge_on: bool, lowest: float) -> None:
    frames = seen_from_still_pan([(lowest - 0.002) * NORMAL, (lowest + 0.002) * NORMAL], edge_on)
    assert frames.flying.tolist() == [False] * 6 + [True]


def test_a_pancake_climbs_as_high_as_it_is_once_it_has_come_down() -> None:
    heights = [0.0, 0.2, 0.3, 0.1, 0.01, 0.028, 0.003]  # thrown, then up the rim
    frames = seen_from_still_pan([height * NORMAL for height in heights])
    assert frames.climb(frames.t[7]) == pytest.approx(0.028)
    assert frames.climb(frames.t[10]) == pytest.approx(0.003)
    assert frames.climb(frames.t[-1]) == 0.0  # nothing is seen afterwards


def test_beside_the_pan_only_the_height_above_it_counts() -> None:
    # The plane of the tilted pan's floor is above one of these and below the other.
    far = PAN_RADIUS + 2.0 * PANCAKE_RADIUS + 0.3
    uphill, downhill = np.array([-far, 0.0, 0.0]), np.array([far, 0.0, 0.0])
    up = np.array([0.0, 0.0, 0.125])
    frames = seen_from_still_pan([uphill + up, downhill + up, uphill, downhill])
    assert frames.height[5] * frames.height[8] < 0.0
    assert frames.flying[5:].tolist() == [True, True, False, False]


def test_frames_outside_the_path_of_the_pan_are_left_out() -> None:
    t = np.array([-0.1, 0.0, 0.5, 1.0, 1.1])
    quat = np.tile(rotations.quat_of_vector(TILT), (5, 1))
    frames = frames_from_pan(still_pan(), BodyPath("t", t, np.tile(PAN, (5, 1)), quat))
    assert frames.t.tolist() == [0.0, 0.5, 1.0]


def test_the_normal_of_a_pancake_never_seen_at_rest_is_unknown() -> None:
    path = BodyPath("t", [0.5], [PAN + 0.2 * NORMAL], [rotations.quat_of_vector(TILT)])
    frames = frames_from_pan(still_pan(), path)
    assert frames.resting_frames == 0
    assert not frames.normal.any()
    assert frames.end_state(0.5) == (False, False)


def test_the_normal_is_the_true_one_whatever_the_axes_of_the_tracked_body() -> None:
    rng = np.random.default_rng(4)
    truth = toss(rng, vz=2.3, half_turns=1.0)  # body axes are random
    path = capture(truth, rng, noise=0.0)
    frames = frames_from_pan(truth.pan, path)
    true = truth.normal[np.searchsorted(truth.t, path.t)]
    assert frames.normal == pytest.approx(true, abs=1e-4)


def test_a_pancake_beside_the_pan_or_on_edge_does_not_rest_in_it() -> None:
    rng = np.random.default_rng(7)
    truth = toss(rng, vz=2.2, half_turns=1.0)
    path = capture(truth, rng)

    def resting(path: BodyPath) -> bool:
        return frames_from_pan(truth.pan, path).end_state(truth.pan.t[-1])[0]

    assert frames_from_pan(truth.pan, path).end_state(truth.pan.t[-1]) == (True, True)
    end = path.t > END - 0.5
    beside = path.position + np.outer(end, [0.3, 0.0, -0.5])
    assert not resting(replace(path, position=beside))
    level = path.position + np.outer(end, [0.3, 0.0, 0.0])
    assert not resting(replace(path, position=level))
    tilted = rotations.multiply(
        np.broadcast_to(rotations.quat_of_vector([0.4, 0.0, 0.0]), path.quat_xyzw.shape),
        path.quat_xyzw,
    )
    quat = np.where(end[:, None], tilted, path.quat_xyzw)
    assert not resting(replace(path, quat_xyzw=quat))
    assert not resting(without(path, end))


def test_the_side_up_is_seen_before_the_start_and_never_after_the_flight() -> None:
    rng = np.random.default_rng(4)
    truth = toss(rng, vz=2.3, half_turns=1.0)
    path = capture(truth, rng)
    quick = without(path, path.t < truth.release + 0.05)  # it left before the first frame
    lain = path.position[:1].repeat(4, axis=0), path.quat_xyzw[:1].repeat(4, axis=0)
    before = BodyPath("t", np.array([-0.13, -0.1, -0.07, -0.03]), *lain)
    frames = frames_from_pan(truth.pan, quick, before)
    assert frames.resting_frames == 4
    true = truth.normal[np.searchsorted(truth.t, quick.t)]
    assert frames.normal == pytest.approx(true, abs=0.1)  # the first frame is no longer level
    assert frames.end_state(truth.pan.t[-1]) == (True, True)
    assert frames_from_pan(truth.pan, quick).resting_frames == 0


def test_sides_that_alternate_at_rest_do_not_tell_which_is_up() -> None:
    rng = np.random.default_rng(4)
    truth = toss(rng, vz=2.3, half_turns=1.0)
    path = capture(truth, rng)
    over = rotations.multiply(np.array([1.0, 0.0, 0.0, 0.0]), path.quat_xyzw)
    odd = (np.arange(len(path.t)) % 2 == 1)[:, None]
    spoilt = replace(path, quat_xyzw=np.where(odd, over, path.quat_xyzw))
    before = replace(spoilt.part(np.arange(4)), t=np.array([-0.13, -0.1, -0.07, -0.03]))
    assert frames_from_pan(truth.pan, path, before).resting_frames == 0
