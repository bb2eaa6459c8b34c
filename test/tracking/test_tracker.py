# SPDX-License-Identifier: Apache-2.0
"""Every fault of a motion capture is refused and named."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath
from wam_power_ros.tracking import marker_fit
from wam_power_ros.tracking.tracker import (
    ClockOffset,
    FrameFault,
    Tracker,
    TrackerSettings,
    Validity,
    free_fall_acceleration,
    late_stamps,
)

SETTINGS = TrackerSettings(
    rate=30.0,
    up_axis="z",
    world_to_base=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    latency_offset=0.0,
    workspace_low=(-2.0, -2.0, -1.0),
    workspace_high=(2.0, 2.0, 3.0),
    speed_max=8.0,
    noise=0.0005,
    single_marker=False,
)
PERIOD = 33_333_333
START = 1_700_000_000_000_000_000
PAN = np.array([0.8, 0.0, 0.6])
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def having(**changes: object) -> TrackerSettings:
    """`SETTINGS` with some changes."""
    return TrackerSettings(**(dict(SETTINGS) | changes))


def stamp(index: float) -> int:
    return START + round(index * PERIOD)


def resting(
    tracker: Tracker, first: int, count: int, rng: np.random.Generator, at: np.ndarray = PAN
) -> list:
    """Frames of a body at rest, with the noise of a real system."""
    return [
        tracker.add(stamp(index), at + rng.normal(0.0, 0.0005, 3), LEVEL)
        for index in range(first, first + count)
    ]


def seen(tracker: Tracker, count: int = 10) -> np.random.Generator:
    rng = np.random.default_rng(3)
    resting(tracker, 0, count, rng)
    return rng


def test_the_angular_velocity_is_in_the_base_frame_and_extrapolates_the_orientation() -> None:
    tracker = Tracker(SETTINGS)
    omega, tilted = np.array([2.0, -1.0, 0.5]), rotations.quat_of_vector(np.array([0.4, 1.1, -0.6]))

    def orientation(t: float) -> np.ndarray:
        return rotations.multiply(rotations.quat_of_vector(omega * t), tilted)

    for index in range(12):
        t = index * PERIOD * 1e-9
        state = tracker.add(stamp(index), PAN + 1e-4 * index, orientation(t))
    np.testing.assert_allclose(state.angular_velocity, omega, atol=1e-6)
    coasted = tracker.at(stamp(13.5))
    assert coasted.validity is Validity.OCCLUDED
    expected = rotations.matrix(orientation(13.5 * PERIOD * 1e-9))
    np.testing.assert_allclose(rotations.matrix(coasted.quat_xyzw), expected, atol=1e-6)


@pytest.mark.parametrize(
    ("position", "quat_xyzw", "fault"),
    [
        ([np.nan, 0.0, 0.6], LEVEL, FrameFault.NOT_FINITE),
        ([0.8, 0.0, 0.6], [0.0, 0.0, np.inf, 1.0], FrameFault.NOT_FINITE),
        ([0.0, 0.0, 0.0], LEVEL, FrameFault.ZERO),
        ([0.8, 0.0, 0.6], [0.0, 0.0, 0.0, 1.0011], FrameFault.NOT_UNIT),
        ([0.8, 0.0, 0.6], [0.0, 0.0, 0.0, 0.9989], FrameFault.NOT_UNIT),
        ([0.8, 0.0005, 0.6], [0.0, 0.0, 0.0, 0.9991], None),  # rounded to three digits
        ([0.8, 0.0005, 0.6], [0.0, 0.0, 0.0, 1.0009], None),
        ([0.8, 0.0, 60.0], LEVEL, FrameFault.OUTSIDE),
        ([0.8, 1.0, 0.6], LEVEL, FrameFault.JUMP),
    ],
)
def test_a_bad_pose_is_refused_by_its_name_and_changes_nothing(
    position: list[float], quat_xyzw: list[float], fault: FrameFault | None
) -> None:
    tracker = Tracker(SETTINGS)
    seen(tracker)
    before = tracker.path("a", stamp(0), stamp(99))
    added = tracker.add(stamp(10), np.array(position), np.array(quat_xyzw))
    assert tracker.fault is fault
    if fault is None:
        assert added is not None
        return
    assert added is None
    assert tracker.counts[fault.value] == 1
    after = tracker.path("a", stamp(0), stamp(99))
    np.testing.assert_array_equal(after.position, before.position)


@pytest.mark.requirement("S-47")
def test_a_pose_that_repeats_bit_for_bit_never_enters_and_is_called_frozen() -> None:
    tracker = Tracker(SETTINGS)
    rng = seen(tracker)
    held = PAN + 0.001
    tracker.add(stamp(10), held, LEVEL)
    tracker.add(stamp(11), held, LEVEL)
    assert tracker.fault is FrameFault.POSE_REPEATED
    assert tracker.validity is Validity.OK  # as of a hidden body
    for index in range(12, 40):
        tracker.add(stamp(index), held, LEVEL)
    assert tracker.validity is Validity.FROZEN
    assert tracker.at(stamp(40)) is None
    assert len(tracker.path("a", stamp(0), stamp(99)).t) == 11
    resting(tracker, 40, 3, rng)
    assert tracker.validity is Validity.OK


@pytest.mark.parametrize(("beyond", "fault"), [(-1e-4, None), (1e-4, FrameFault.JUMP)])
def test_a_body_may_move_at_its_largest_speed_and_five_sigma_and_no_farther(
    beyond: float, fault: FrameFault | None
) -> None:
    for frames in (1, 30):
        tracker = Tracker(having(speed_max=1.5, noise=0.002))
        tracker.add(stamp(0), PAN, LEVEL)
        reach = 1.5 * frames / 30.0 + 5.0 * 0.002
        tracker.add(stamp(frames), PAN - np.array([reach + beyond, 0.0, 0.0]), LEVEL)
        assert tracker.fault is fault
    tracker = Tracker(SETTINGS)
    tracker.add(stamp(0), PAN, LEVEL)
    tracker.add(stamp(1), PAN + np.array([0.0, 1.5, 0.0]), LEVEL)
    assert tracker.fault is FrameFault.JUMP
    reach = 8.0 * 2.0 / 30.0 + 5.0 * 0.0005  # after a jump, of two periods
    tracker.add(stamp(20), PAN - np.array([reach + beyond, 0.0, 0.0]), LEVEL)
    assert tracker.fault is fault


@pytest.mark.requirement("S-47")
def test_a_swap_of_bodies_never_enters_and_scattered_jumps_lose_the_pancake() -> None:
    tracker = Tracker(SETTINGS)
    seen(tracker)
    for index in range(10, 15):
        tracker.add(stamp(index), PAN + np.array([0.0, (-1.0) ** index * 1.0, 0.0]), LEVEL)
    assert tracker.validity is Validity.LOST
    assert tracker.at(stamp(15)) is None


def test_a_body_moved_by_hand_while_hidden_is_found_again() -> None:
    tracker = Tracker(SETTINGS)
    rng = seen(tracker)
    states = resting(tracker, 10, 8, rng, at=PAN + np.array([0.0, 0.0, -1.2]))
    assert [state is None for state in states] == [True] * 5 + [False] * 3
    assert tracker.validity is Validity.OK
    assert tracker.counts["found again"] == 1


def test_a_hidden_body_is_extrapolated_for_a_tenth_of_a_second_and_then_lost() -> None:
    tracker = Tracker(SETTINGS)
    velocity = np.array([0.5, 0.0, 1.0])
    for index in range(6):
        tracker.add(stamp(index), PAN + velocity * index * PERIOD * 1e-9, LEVEL)
    assert tracker.at(stamp(6.9)).validity is Validity.OK
    coasted = tracker.at(stamp(8))
    assert coasted.validity is tracker.validity is Validity.OCCLUDED
    np.testing.assert_allclose(coasted.position, PAN + velocity * 8 * PERIOD * 1e-9, atol=1e-6)
    assert tracker.at(stamp(6.9)).variance == SETTINGS.noise**2
    # It may have started to fall at the last frame.
    fallen = 0.5 * 9.81 * (3 * PERIOD * 1e-9) ** 2
    assert coasted.variance == pytest.approx((SETTINGS.noise + fallen) ** 2, rel=1e-6)
    assert tracker.at(stamp(5 + 2) + 110_000_000) is None
    assert tracker.validity is Validity.LOST


def test_stamps_that_repeat_or_go_back_are_refused() -> None:
    tracker = Tracker(SETTINGS)
    seen(tracker, 5)
    for when, fault in [(stamp(4), FrameFault.STAMP_REPEATED), (stamp(3), FrameFault.STAMP_BACK)]:
        assert tracker.add(when, PAN + 1e-4, LEVEL) is None
        assert tracker.fault is fault
    assert len(tracker.path("a", stamp(0), stamp(99)).t) == 5


def test_of_frames_delivered_together_the_last_one_counts() -> None:
    tracker = Tracker(SETTINGS)
    velocity, receipt = np.array([3.0, 0.0, 0.0]), 100_000  # [ns] between receipts

    def place(index: float) -> np.ndarray:
        return PAN + velocity * index * PERIOD * 1e-9

    for index in range(6):  # each comes together with the one exposed half a period before
        tracker.add(stamp(index) - receipt, place(index - 0.5), LEVEL)
        state = tracker.add(stamp(index), place(index), LEVEL)
    np.testing.assert_allclose(state.velocity, velocity, atol=1e-9)
    path = tracker.path("a", stamp(0), stamp(99))
    np.testing.assert_allclose(path.position, [place(index) for index in range(6)], atol=1e-12)
    assert (tracker.counts["accepted"], tracker.counts["older of a pair"]) == (6, 6)
    # a repeated frame or a jump does not remove accepted frames
    assert tracker.add(stamp(5) + receipt, place(5), LEVEL) is None
    assert tracker.add(stamp(5) + 2 * receipt, PAN + 1.0, LEVEL) is None
    assert len(tracker.path("a", stamp(0), stamp(99)).t) == 6


def test_a_clock_that_is_set_back_starts_the_track_again() -> None:
    tracker = Tracker(SETTINGS)
    seen(tracker)
    rng = np.random.default_rng(5)
    hour = 3600 * 1_000_000_000
    for index in range(15):
        tracker.add(stamp(index) - hour, PAN + rng.normal(0.0, 0.0005, 3), LEVEL)
    assert tracker.validity is Validity.OK
    assert tracker.counts["clock set back"] == 1
    assert len(tracker.path("a", stamp(0) - hour, stamp(99) - hour).t) == 6


def test_the_path_does_not_depend_on_absolute_time() -> None:
    paths = []
    for shift in (-START + 1, 0, 123_456_789_012_345_678):
        tracker = Tracker(SETTINGS)
        rng = np.random.default_rng(0)
        for index in range(40):
            tracker.add(stamp(index) + shift, PAN + rng.normal(0.0, 0.0005, 3), LEVEL)
        paths.append(tracker.path("trial-1", stamp(5) + shift + 7, stamp(30) + shift))
    assert len(paths[0].t) == 31  # from before the start
    expected = (np.arange(31) - 5) * PERIOD * 1e-9  # since the start, which was 7 ns after one
    np.testing.assert_allclose(paths[0].t, expected, rtol=0.0, atol=1e-8)
    for path in paths[1:]:
        np.testing.assert_array_equal(path.t, paths[0].t)
        np.testing.assert_array_equal(path.position, paths[0].position)


def test_world_to_base_and_latency_are_taken_out() -> None:
    quarter = rotations.quat_of_vector(np.array([0.0, 0.0, np.pi / 2]))
    tracker = Tracker(having(world_to_base=(0.1, 0.2, 0.3, *quarter.tolist()), latency_offset=0.02))
    for index in range(3):
        state = tracker.add(stamp(index), np.array([0.5, 0.0, 0.3]) + 1e-5 * index, LEVEL)
    assert state.stamp_ns == stamp(2) - 20_000_000
    np.testing.assert_allclose(state.position, [0.1, 0.7, 0.6], atol=1e-4)
    np.testing.assert_allclose(np.abs(state.quat_xyzw), np.abs(quarter), atol=1e-12)


def test_a_body_with_one_marker_has_a_position_and_no_orientation() -> None:
    one = Tracker(having(single_marker=True, up_axis="y"))
    rng = np.random.default_rng(2)
    for index in range(6):
        x, y, z = PAN + 0.002 * rng.normal(size=3)
        points = np.array([[x, z, -y], [9.0, 9.0, 9.0]])  # another one outside the workspace
        state = one.add_markers(stamp(index), rng.permutation(points))
    np.testing.assert_allclose(state.position, [x, y, z], atol=1e-12)
    assert (state.validity, one.counts["accepted"]) == (Validity.OK, 6)
    path = one.path("a", stamp(0), stamp(5))
    np.testing.assert_array_equal(path.quat_xyzw, np.tile(LEVEL, (6, 1)))
    turned = rotations.quat_of_vector(np.array([0.3, 0.0, 0.1]))
    assert one.add(stamp(6), np.array([x, z, -y + 0.001]), turned) is not None
    np.testing.assert_array_equal(one.path("a", stamp(6), stamp(6)).quat_xyzw[-1], LEVEL)


def test_of_several_points_the_marker_is_the_one_that_is_clearly_nearest_to_the_last() -> None:
    one = Tracker(having(single_marker=True))
    stray = PAN + np.array([0.2, 0.0, 0.0])
    assert one.add_markers(stamp(0), np.stack([PAN, stray])) is None  # which one is the body's?
    assert (one.fault, one.latest_ns) == (FrameFault.MARKERS, stamp(0))
    for index, offset in enumerate(([0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.03, 0.0, 0.0]), start=1):
        points = np.stack([stray, PAN + offset]) if index > 1 else PAN[np.newaxis]
        one.add_markers(stamp(index), points)
    assert one.counts["accepted"] == 3
    midway = PAN + np.array([0.11, 0.0, 0.0])  # 0.08 m from the last, the other marker 0.17 m
    assert one.add_markers(stamp(4), np.stack([stray, midway])) is not None
    between = midway + np.array([0.05, 0.0, 0.0])
    assert one.add_markers(stamp(5), np.stack([stray, between])) is None
    assert one.fault is FrameFault.MARKERS
    assert one.add_markers(stamp(6), np.empty((0, 3))) is None


def test_markers_give_the_state_of_the_pose() -> None:
    by_pose, by_markers = Tracker(SETTINGS), Tracker(SETTINGS)
    rng = np.random.default_rng(2)
    for index in range(4):
        vector = 0.3 * rng.normal(size=3)
        points = rng.permutation(marker_fit.LAYOUT) @ rotations.exp(vector).T + PAN
        pose = by_pose.add(stamp(index), PAN, rotations.quat_of_vector(vector))
        same = by_markers.add_markers(stamp(index), points)
    np.testing.assert_allclose(same.position, pose.position, atol=1e-9)
    np.testing.assert_allclose(same.angular_velocity, pose.angular_velocity, atol=1e-5)
    assert by_markers.add_markers(stamp(4), points[:2]) is None
    assert by_markers.fault is FrameFault.MARKERS
    assert by_markers.latest_ns == stamp(4)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"rate": 0.0}, "rate"),
        ({"up_axis": "x"}, "up_axis"),
        ({"world_to_base": (0.0,) * 6}, "world_to_base"),
        ({"world_to_base": (0.0,) * 7}, "length 1"),
        ({"latency_offset": -1.5}, "latency_offset"),
        ({"workspace_low": (0.0, 0.0, 3.0)}, "workspace"),  # as high as the upper corner
        ({"noise": float("nan")}, "noise"),
    ],
)
def test_settings_that_cannot_be_are_refused(change: dict, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        having(**change)


number = st.floats(width=64) | st.floats(-2.0, 2.0)
frames = st.lists(
    st.tuples(
        st.integers(-(10**9), 10**18) | st.integers(START, START + 10**9),
        hnp.arrays(float, 3, elements=number) | st.just(PAN),
        hnp.arrays(float, 4, elements=number) | st.just(LEVEL),
    ),
    max_size=40,
)


@given(frames=frames)
@settings(max_examples=60)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_any_frames_give_finite_states_and_a_path_in_order(frames: list) -> None:
    tracker = Tracker(SETTINGS)
    for when, position, quat in frames:
        for state in (tracker.add(when, position, quat), tracker.at(when + 90_000_000)):
            if state is not None:
                values = np.concatenate([np.ravel(value) for value in state[1:6]])
                assert np.isfinite(values).all()
    events = tracker.counts["clock set back"] + tracker.counts["found again"]
    assert sum(tracker.counts.values()) - events == len(frames)
    path = tracker.path("a", -(10**19), 10**19)  # raises for what is not finite or in order
    assert len(path.t) <= tracker.counts["accepted"]


@pytest.mark.parametrize("rate", [30.0, 240.0])
def test_another_solution_of_the_orientation_is_refused_while_it_lasts(rate: float) -> None:
    tracker = Tracker(having(rate=rate))
    over, omega = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 12.0, 0.0])
    rng = np.random.default_rng(5)
    for index in range(round(rate)):
        t = index / rate
        turned = rotations.quat_of_vector(omega * max(t - 0.5, 0.0))
        wrong = index % 3 == 2
        quat = rotations.multiply(turned, over) if wrong else turned
        at = PAN + rng.normal(0.0, 0.0005, 3)
        state = tracker.add(START + round(t * 1e9), at, quat)
        assert (tracker.fault is FrameFault.TURN) is wrong, t
        assert not wrong or state is None
    turned = rotations.multiply(turned, over)  # from now on: taken after longer than a rollout
    taken = []
    for index in range(round(rate), round(5 * rate)):
        at = PAN + rng.normal(0.0, 0.0005, 3)
        tracker.add(START + round(index / rate * 1e9), at, turned)
        taken.append(tracker.fault is None)
    assert not any(taken[: round(2.9 * rate)]) and all(taken[round(3.2 * rate) :])


def test_the_offset_of_two_clocks_is_the_age_that_jitter_cannot_lower() -> None:
    offset = ClockOffset()
    assert offset.seconds == 0.0
    for jitter in (7_000_000, 0, 3_000_000):
        offset.add(START, START + 250_000_000 + jitter)
    assert offset.seconds == pytest.approx(0.25)
    for index in range(240):  # two seconds of frames at once: the tracker was not scheduled
        offset.add(START + index * 8_333_333, START + 2_500_000_000 + index * 100_000)
    assert offset.seconds == pytest.approx(0.25)
    for index in range(20):  # if all frames are late for long, the clocks differ
        now_ns = START + (5 + index) * 1_000_000_000
        offset.add(now_ns - 600_000_000, now_ns)
    assert offset.seconds == pytest.approx(0.6)
    recent = ClockOffset()
    for second, age in ((0.0, 0.1), (5.0, 0.3), (5.1, 0.3)):
        recent.add(START + round((second - age) * 1e9), START + round(second * 1e9))
        assert recent.seconds == pytest.approx(0.1 if second <= 5.0 else 0.3)
    behind = ClockOffset()
    behind.add(START, START - 40_000_000)
    assert behind.seconds == pytest.approx(-0.04)


def test_late_stamps_have_the_cause_that_can_be_seen() -> None:
    assert "0.600 s off: synchronise the clocks" in late_stamps(0.6)
    assert "use_sim_time" in late_stamps(1.7e9) and "use_sim_time" in late_stamps(-1.7e9)


def path_of(position: np.ndarray) -> BodyPath:
    t = np.arange(len(position)) / 30.0
    return BodyPath("a", t, position, np.tile(LEVEL, (len(t), 1)))


def test_a_free_fall_shows_the_direction_of_gravity() -> None:
    t = np.arange(45) / 30.0
    free = np.clip(t - 0.5, 0.0, 0.6)  # carried, thrown and caught
    flight = PAN + np.stack([0.3 * free, 0.0 * t, 2.9 * free - 0.5 * 9.81 * free**2], axis=1)
    flight += np.random.default_rng(0).normal(0.0, 0.0005, flight.shape)
    down = free_fall_acceleration(path_of(flight))
    assert down[2] < -9.0 and np.linalg.norm(down[:2]) < 0.5
    swapped = flight @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]).T
    assert free_fall_acceleration(path_of(swapped))[1] < -9.0
    assert free_fall_acceleration(path_of(np.tile(PAN, (45, 1)))) is None
    for gravity, found in ((8.7, False), (8.9, True), (10.7, True), (10.9, False)):
        thrown = path_of(PAN + np.outer(4.0 * t - 0.5 * gravity * t**2, [0.0, 0.0, 1.0]))
        assert (free_fall_acceleration(thrown) is not None) == found
        if found:
            expected = [0.0, 0.0, -gravity]
            np.testing.assert_allclose(free_fall_acceleration(thrown), expected, atol=1e-6)
