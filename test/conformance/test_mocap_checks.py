# SPDX-License-Identifier: Apache-2.0
"""Mistakes of a motion capture driver show in its frames."""

from __future__ import annotations

import numpy as np
import pytest

from wam_power_ros import rotations
from wam_power_ros.conformance import mocap_checks
from wam_power_ros.conformance.mocap_checks import CloudSample, FrameSample
from wam_power_ros.conformance.topic_checks import Row, Verdict
from wam_power_ros.tracking import marker_fit
from wam_power_ros.tracking.tracker import Y_UP, TrackerSettings

SECOND = 1_000_000_000  # [ns]
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
SETTINGS = TrackerSettings(
    rate=30.0,
    up_axis="z",
    world_to_base=(0.0, 0.0, 0.0, *LEVEL),
    latency_offset=0.0,
    workspace_low=(-2.5, -2.5, -2.0),
    workspace_high=(2.5, 2.5, 3.0),
    speed_max=8.0,
    noise=0.0005,
    single_marker=False,
)


def having(**changes: object) -> TrackerSettings:
    """`SETTINGS` with some changes."""
    return TrackerSettings(**(dict(SETTINGS) | changes))


def frames(positions: np.ndarray, rate: float = 30.0) -> list[FrameSample]:
    stamps = SECOND + np.rint(np.arange(len(positions)) / rate * 1e9).astype(int)
    return [
        FrameSample(int(stamp) + 40_000_000, int(stamp), position, LEVEL)
        for stamp, position in zip(stamps, positions, strict=True)
    ]


def lying(count: int = 60) -> np.ndarray:
    noise = np.random.default_rng(21).normal(scale=3e-4, size=(count, 3))
    return np.array([0.76, 0.0, 0.5]) + noise


def dropped(turn: np.ndarray | None = None) -> np.ndarray:
    """Positions at rest, in free fall for 0.4 s, and at rest again, in a rotated camera frame."""
    fall = np.clip(np.arange(40) / 30.0 - 0.5, 0.0, 0.4)
    positions = lying(40) - np.outer(0.5 * 9.81 * fall**2, [0.0, 0.0, 1.0])
    return positions if turn is None else positions @ turn.T


def usable(seen: list[FrameSample], **refused: int) -> dict[str, Row]:
    return {row.name: row for row in mocap_checks.frame_quality(seen, SETTINGS, refused)}


def test_a_pose_that_repeats_is_frozen_and_a_lost_frame_is_not() -> None:
    still = np.tile([0.7, 0.0, 0.5], (40, 1))
    rows = usable(frames(still))
    assert rows["mocap frozen"].verdict is Verdict.FAIL
    assert rows["mocap poses"].verdict is Verdict.OK  # one mistake, one failure
    twice = lying()
    twice[7] = twice[6]
    assert {row.verdict for row in usable(frames(twice)).values()} == {Verdict.OK}


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        (lambda f: f._replace(position=np.zeros(3)), "sends zeros"),
        (lambda f: f._replace(position=1000.0 * f.position), "not metres"),
        (lambda f: f._replace(quat_xyzw=2.0 * LEVEL), "unit quaternions"),
    ],
)
def test_poses_that_the_tracker_refuses_are_named(change: object, fragment: str) -> None:
    row = usable([change(frame) for frame in frames(lying())])["mocap poses"]
    assert (row.verdict, fragment in row.advice) == (Verdict.FAIL, True)
    row = usable([], **{"no x, y, z": 9})["mocap poses"]  # of messages that cannot be read
    assert (row.verdict, "9 no x, y, z" in row.found) == (Verdict.FAIL, True)
    assert usable([])["mocap poses"].verdict is Verdict.UNCHECKED


@pytest.mark.parametrize(
    ("age", "offset", "expected"),
    [
        (0.04, 0.0, Verdict.OK),
        (0.001, 0.0, Verdict.WARN),
        (0.001, 0.03, Verdict.OK),
        (-0.5, 0.0, Verdict.FAIL),
        (0.5, 0.0, Verdict.FAIL),
    ],
)
def test_latency_is_relative_to_the_arms_clock(
    age: float, offset: float, expected: Verdict
) -> None:
    stamps = np.arange(10) * SECOND
    received = stamps + round((7.0 + age) * 1e9)  # independent of this machine's clock
    assert mocap_checks.latency(received, stamps, 7.0, offset, 0.2).verdict is expected


def clouds(points: np.ndarray) -> list[CloudSample]:
    """Ten clouds of these points (10, N, 3)."""
    return [CloudSample(0, i * SECOND, each) for i, each in enumerate(points)]


def test_the_marker_layout_or_the_one_marker_is_searched_in_every_cloud() -> None:
    places = lying(10)[:, None]
    layout, one = places + marker_fit.LAYOUT, having(single_marker=True)
    stray = np.concatenate([places, np.tile([[[0.6, 0.0, 0.0]]], (10, 1, 1))], axis=1)
    for settings, right, wrong, said in (
        (SETTINGS, layout, 1000.0 * layout, "metres"),
        (one, places, stray, "cover other"),
    ):
        seen, row = mocap_checks.marker_poses(clouds(right), settings)
        assert row.verdict is Verdict.OK
        np.testing.assert_allclose([each.position for each in seen], places[:, 0], atol=1e-9)
        _, row = mocap_checks.marker_poses(clouds(wrong), settings)
        assert (row.verdict, said in row.advice) == (Verdict.FAIL, True)
        assert mocap_checks.marker_poses([], settings)[1].verdict is Verdict.UNCHECKED


def test_a_body_in_the_pan_is_measured_in_the_pan() -> None:
    pan = np.array([0.76, 0.0, 0.49])
    seen = frames(lying())
    assert mocap_checks.body_position(seen, SETTINGS, pan).verdict is Verdict.OK
    moved = having(world_to_base=(0.5, 0.0, 0.0, *LEVEL))
    assert mocap_checks.body_position(seen, moved, pan).verdict is Verdict.WARN
    assert mocap_checks.body_position(seen, SETTINGS, None).verdict is Verdict.UNCHECKED


FORWARD_UP = rotations.matrix(np.array([0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)]))  # z to x
TILT = rotations.matrix(rotations.quat_of_vector(np.array([np.deg2rad(15.0), 0.0, 0.0])))


@pytest.mark.parametrize(
    ("turn", "up_axis", "expected", "fragment"),
    [
        (np.eye(3), "z", Verdict.OK, ""),
        (Y_UP.T, "y", Verdict.OK, ""),
        (Y_UP.T, "z", Verdict.FAIL, "Y-up: set up_axis: y"),
        (np.eye(3), "y", Verdict.FAIL, "Z-up: set up_axis: z"),
        (-np.eye(3), "z", Verdict.FAIL, "-z of the motion capture is up"),
        (FORWARD_UP, "z", Verdict.FAIL, "+x of the motion capture is up"),
        (TILT, "z", Verdict.WARN, "15 degrees off"),
    ],
)
def test_a_fall_shows_the_vertical_axis(
    turn: np.ndarray, up_axis: str, expected: Verdict, fragment: str
) -> None:
    row = mocap_checks.fall_direction(frames(dropped(turn)), having(up_axis=up_axis))
    assert row.verdict is expected
    assert fragment in row.advice


def test_a_fall_in_millimetres_is_named_and_without_a_fall_nothing_is_checked() -> None:
    row = mocap_checks.fall_direction(frames(1000.0 * dropped()), SETTINGS)
    assert (row.verdict, row.advice) == (Verdict.FAIL, "send metres")
    for seen in (frames(lying()), []):
        assert mocap_checks.fall_direction(seen, SETTINGS).verdict is Verdict.UNCHECKED


def test_frames_in_pairs_and_lost_ones_do_not_hide_a_fall() -> None:
    seen = frames(dropped())
    pairs = [twin for f in seen for twin in (f, f._replace(stamp_ns=f.stamp_ns + 100_000))]
    nowhere = pairs[5]._replace(stamp_ns=pairs[5].stamp_ns + 1, position=np.full(3, np.nan))
    pairs.insert(6, nowhere)
    assert mocap_checks.fall_direction(pairs, SETTINGS).verdict is Verdict.OK
