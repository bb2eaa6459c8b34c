# SPDX-License-Identifier: Apache-2.0
"""Observed flights of a simulated light disc at 30 Hz against ground truth, and their parts."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from simulated_toss import END, GRAVITY, Toss, at, capture, toss, without

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.tasks.flip.ballistic_fit import (
    Arc,
    Crossing,
    find_crossing,
    fit_arc,
    release_time,
)
from wam_power_ros.tasks.flip.clock_offset import clock_offset, shifted
from wam_power_ros.tasks.flip.flight import ORIENTATION_JUMPS, Flight, observe_flight
from wam_power_ros.tasks.flip.frames import (
    DELTA_H,
    PAN_RADIUS,
    PANCAKE_RADIUS,
    Frames,
    frames_from_pan,
    interpolate,
)
from wam_power_ros.tasks.flip.spin_fit import (
    Spin,
    _spin_guesses,
    _SpinProblem,
    angle_between,
    fit_spin,
)


def true_angle(toss: Toss) -> float:
    """Rotation about the spin axis until t_f."""
    return at(toss, toss.t_f, toss.winding)


def errors(toss: Toss, flight: Flight) -> tuple[float, float, float, float]:
    """Errors of t_f [s], position [m], normal [rad] and angle [rad]."""
    position = flight.position - at(toss, toss.t_f, toss.position)
    normal = angle_between(flight.normal, at(toss, toss.t_f, toss.normal))
    distance = float(np.linalg.norm(position))
    return flight.t_f - toss.t_f, distance, normal, flight.angle - true_angle(toss)


def many(count: int, seed: int, lose: float, air: float) -> list[tuple[Toss, Flight]]:
    rng = np.random.default_rng(seed)
    result = []
    while len(result) < count:
        truth = toss(rng, air=air, precession=rng.uniform(0.0, 0.2))
        flight = observe_flight(truth.pan, capture(truth, rng, dropout=lose))[0]
        if math.isfinite(truth.t_f) and flight.t_f < truth.pan.t[-1]:
            result.append((truth, flight))
    return result


@pytest.mark.parametrize(("lose", "air"), [(0.4, 1.0), (0.0, 2.0)])
def test_nine_fits_of_ten_are_within_a_millisecond_a_millimetre_and_a_degree(
    lose: float, air: float
) -> None:
    flights = many(30, seed=5, lose=lose, air=air)
    seen = [(truth, flight) for truth, flight in flights if flight.seen]
    assert len(seen) >= 0.9 * len(flights)
    found = np.abs([errors(truth, flight) for truth, flight in seen])
    limits = np.array([0.001, 0.001, math.radians(1.0), math.radians(1.0)])
    assert np.all(np.percentile(found, 90, axis=0) < limits)
    assert np.all(np.median(found, axis=0) < 0.5 * limits)


@pytest.mark.parametrize("vz", [1.6, 2.3])
def test_the_pitch_of_the_pan_at_the_catch_is_positive_with_its_front_edge_up(vz: float) -> None:
    truth = toss(np.random.default_rng(3), vz=vz, half_turns=1.0)
    seen = capture(truth, np.random.default_rng(3))
    for pitch in (-0.2, 0.3):  # a turn about y lowers the front, which is along x
        fixed = rotations.quat_of_vector([0.0, -pitch, 0.0])
        quat = rotations.multiply(np.tile(fixed, (len(truth.pan.t), 1)), truth.pan.quat_xyzw)
        level = observe_flight(truth.pan, seen)[0].catch_pitch
        tilted = observe_flight(replace(truth.pan, quat_xyzw=quat), seen)[0].catch_pitch
        assert tilted - level == pytest.approx(pitch, abs=0.02)


def test_a_spin_of_twenty_radians_a_second_is_not_mistaken_for_a_slower_one() -> None:
    rng = np.random.default_rng(11)
    for _ in range(5):
        truth = toss(rng, vz=3.0, half_turns=20.0 * 2.0 * 3.0 / GRAVITY / math.pi, air=0.0)
        flight = observe_flight(truth.pan, capture(truth, rng))[0]
        assert flight.angle == pytest.approx(true_angle(truth), abs=0.5)


def test_of_a_flight_that_begins_with_a_leap_from_the_pan_the_rotation_is_not_known() -> None:
    """As of one that touched the rim: how far it had turned before is not in its frames."""
    truth = toss(np.random.default_rng(3), vz=2.6, half_turns=0.8)
    path = capture(truth, np.random.default_rng(3))
    flew = (path.t > truth.release) & (path.t < truth.t_f)
    turn = np.tile(rotations.quat_of_vector([0.0, 1.6, 0.0]), (len(path.t), 1))
    leapt = np.where(flew[:, None], rotations.multiply(turn, path.quat_xyzw), path.quat_xyzw)
    assert observe_flight(truth.pan, path)[1] == ""
    _, doubt = observe_flight(truth.pan, replace(path, quat_xyzw=leapt))
    assert doubt == ORIENTATION_JUMPS


def test_a_flight_that_a_touch_of_the_rim_has_changed_is_seen_by_the_frames_after_it() -> None:
    """A pan that follows the pancake upwards may touch it near its highest point."""
    truth = toss(np.random.default_rng(3), vz=2.6, half_turns=0.8)
    frames = frames_from_pan(truth.pan, capture(truth, np.random.default_rng(3)))
    whole = frames.flight()
    touch = int(whole[np.argmax(frames.position[whole, 2])]) + 1
    off = np.maximum(frames.t[touch] - frames.t, 0.0)[:, None] * np.array([0.9, 0.0, -0.9])
    flying = frames.flying & (np.arange(len(frames.t)) != touch)
    touched = replace(frames, position=frames.position + off, flying=flying)
    assert touched.flight().tolist() == whole[whole > touch].tolist()
    fall, seen = fit_arc(touched), fit_arc(frames)
    late = frames.t[whole[-1]]
    np.testing.assert_allclose(fall.position(late), seen.position(late), atol=0.002)
    two = replace(frames, flying=frames.flying & (np.arange(len(frames.t)) != whole[-3]))
    assert two.flight().tolist() == whole[:-3].tolist(), "two frames tell no flight"


@pytest.mark.parametrize(("vz", "tossed"), [(1.6, False), (2.4, True)])
def test_a_low_toss_is_seen_at_its_top_and_the_apex_is_over_where_the_pan_began(
    vz: float, tossed: bool
) -> None:
    rng = np.random.default_rng(1)
    truth = toss(rng, vz=vz, half_turns=0.6)
    path = capture(truth, rng)
    began = truth.pan.position.copy()
    began[0, 2] -= 0.1
    flight = observe_flight(truth.pan, path)[0]
    lower = observe_flight(replace(truth.pan, position=began), path)[0]
    assert flight.tossed == lower.tossed == tossed
    assert lower.apex == pytest.approx(flight.apex + 0.1, abs=1e-3)
    assert flight.seen
    if not tossed:
        top = int(np.argmax(truth.position[:, 2]))
        turned = angle_between(truth.normal[0], truth.normal[top])
        pan = interpolate(truth.t[top], truth.pan.t, truth.pan.position)
        miss = truth.position[top] - pan
        assert miss[2] < 0.5 * DELTA_H and turned > 0.4
        assert flight.angle == pytest.approx(miss[2] / DELTA_H * turned, abs=0.05)
        assert flight.landing_error[:2] == pytest.approx(miss[:2], abs=0.004)
        moved = replace(truth.pan, position=truth.pan.position + np.eye(3)[0] * 0.03)
        aside = flight.landing_error - observe_flight(moved, path)[0].landing_error
        assert aside == pytest.approx([0.03, 0.0, 0.0], abs=1e-6)


def test_losing_the_view_is_reported_and_never_breaks_the_numbers() -> None:
    rng = np.random.default_rng(12)
    for vz in (0.8, 2.3):
        truth = toss(rng, vz=vz, half_turns=1.0)
        path = capture(truth, rng)
        for keep in range(0, len(path.t) + 1, 3):  # the body is hidden after, before so many
            hidden = np.arange(len(path.t)) >= keep
            for lost in (hidden, ~hidden):
                flight = observe_flight(truth.pan, without(path, lost))[0]
                assert all(np.all(np.isfinite(value)) for value in vars(flight).values())
        nothing = observe_flight(truth.pan, without(path, path.t > 0.0))[0]
        assert (nothing.tossed, nothing.seen, nothing.resting) == (False, False, False)
        assert np.array_equal(nothing.landing_error, np.zeros(3))
    air = (path.t > truth.release) & (path.t < truth.t_f + 0.1)
    one = np.flatnonzero(air)[len(np.flatnonzero(air)) // 2]
    single = observe_flight(truth.pan, without(path, air & (np.arange(len(path.t)) != one)))[0]
    assert (single.tossed, single.seen) == (True, False)


def test_a_descent_that_frames_of_the_rise_do_not_foretell_counts_as_not_seen() -> None:
    rng = np.random.default_rng(12)
    truth = toss(rng, vz=3.4, half_turns=1.0)
    path = capture(truth, rng)
    for rise, seen in ((0.1, False), (0.4, True)):
        flight = observe_flight(truth.pan, without(path, path.t > truth.release + rise))[0]
        assert (flight.tossed, flight.seen) == (True, seen)
        assert np.any(flight.landing_error) == seen


@settings(max_examples=8, deadline=None, derandomize=True)
@given(
    rate=some.sampled_from([30.0, 60.0, 120.0, 240.0]),
    late=some.floats(-0.05, 0.05),
    seed=some.integers(0, 1000),
)
def test_stamps_up_to_50_ms_early_or_late_are_found_to_3_ms_and_change_no_flight(
    rate: float, late: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    truth = toss(rng, half_turns=1.0)
    path = capture(truth, rng, rate)
    given, before = shifted(path, None, -late)
    found = clock_offset(truth.pan, given, before)
    assert found == pytest.approx(late, abs=0.003)
    flight, doubt = observe_flight(truth.pan, *shifted(given, before, found))
    expected, _ = observe_flight(truth.pan, path)
    assert not doubt
    assert flight.angle == pytest.approx(expected.angle, abs=0.1)
    assert flight.t_f == pytest.approx(expected.t_f, abs=0.006)


def test_a_pan_at_rest_shows_no_offset() -> None:
    rng = np.random.default_rng(1)
    truth = toss(rng)
    count = (len(truth.pan.t), 1)
    position, quat = truth.pan.position[0], truth.pan.quat_xyzw[0]
    still = EndEffectorPath("t", truth.pan.t, np.tile(position, count), np.tile(quat, count))
    assert clock_offset(still, capture(truth, rng), None) == 0.0


def arc_through(truth: Toss, path: BodyPath) -> Arc:
    arc = fit_arc(frames_from_pan(truth.pan, path))
    assert arc is not None
    return arc


def crossing_of(truth: Toss, path: BodyPath) -> Crossing:
    crossing = find_crossing(arc_through(truth, path), truth.pan, DELTA_H)
    assert crossing is not None
    return crossing


def test_there_is_no_arc_through_fewer_than_two_frames_or_one_never_at_rest() -> None:
    rng = np.random.default_rng(15)
    truth = toss(rng, vz=2.4, half_turns=1.0)
    path = capture(truth, rng)
    used = arc_through(truth, path).used
    air = np.flatnonzero(frames_from_pan(truth.pan, path).flying)
    for keep, expected in ((used[:0], False), (used[5:6], False), (used[5:7], True)):
        lost = np.isin(np.arange(len(path.t)), np.setdiff1d(air, keep))
        assert (fit_arc(frames_from_pan(truth.pan, without(path, lost))) is not None) == expected
    only_air = without(path, ~np.isin(np.arange(len(path.t)), air))
    assert fit_arc(frames_from_pan(truth.pan, only_air)) is None


def test_the_covariance_grows_with_the_scatter_of_the_frames() -> None:
    rng = np.random.default_rng(17)
    truth = toss(rng, vz=2.4, half_turns=1.0)
    calm = arc_through(truth, capture(truth, np.random.default_rng(1)))
    noisy = arc_through(truth, capture(truth, np.random.default_rng(1), noise=20.0))
    assert noisy.covariance[0, 0] > 10.0 * calm.covariance[0, 0]
    exact = arc_through(truth, capture(truth, np.random.default_rng(1), noise=0.0))
    # The noise of the cameras is expected and does not scale the covariance.
    assert calm.covariance[0, 0] == pytest.approx(exact.covariance[0, 0], rel=0.3)


def test_the_release_is_found_between_two_frames() -> None:
    # A level pan at rest; the pancake lies 2.5 mm above its floor and leaves it at 2 m/s.
    pan_t = np.linspace(0.0, 1.0, 101)
    level = [0.0, 0.0, 0.0, 1.0]
    pan = EndEffectorPath("t", pan_t, np.zeros((101, 3)), np.tile(level, (101, 1)))
    for release in np.linspace(0.3, 0.34, 4):
        t = np.arange(0.0, 0.65, 1.0 / 30.0)
        s = np.maximum(t - release, 0.0)
        height = 0.0025 + 2.0 * s - 0.5 * GRAVITY * s**2
        position = np.outer(height, [0.0, 0.0, 1.0])
        frames = frames_from_pan(pan, BodyPath("t", t, position, np.tile(level, (len(t), 1))))
        arc = fit_arc(frames)
        assert arc is not None
        # It is released 10 mm above the floor, but not before a frame below the rim.
        expected = max(release + 0.004, t[~frames.flying & (t < arc.t[0])][-1])
        assert release_time(frames, arc, pan) == pytest.approx(expected, abs=0.003)


def test_a_wild_frame_in_the_flight_changes_little() -> None:
    rng = np.random.default_rng(6)
    for _ in range(2):
        truth = toss(rng, vz=2.4, half_turns=1.0)
        path = capture(truth, rng)
        crossing = crossing_of(truth, path)
        k = int(np.argmin(np.abs(path.t - truth.release - 0.2)))
        position = path.position.copy()
        position[k] += [0.05, -0.03, 0.06]
        spoilt = crossing_of(truth, replace(path, position=position))
        assert spoilt.t == pytest.approx(crossing.t, abs=0.002)
        assert np.linalg.norm(spoilt.position - crossing.position) < 0.004


UP = np.array([0.0, 0.0, 1.0])

OMEGA = np.array([0.3, -7.0, 1.0])  # [rad/s]


def spin(omega: np.ndarray = OMEGA, decay: float = 0.0, **changes: object) -> Spin:
    values = {
        "origin": 0.5,
        "release": 0.2,
        "normal0": UP,
        "theta": np.array([0.0, 0.0, *omega, decay]),
    }
    return Spin(**{**values, **changes})


def fitted(truth: Toss, path: BodyPath) -> Spin:
    frames = frames_from_pan(truth.pan, path)
    arc = fit_arc(frames)
    assert arc is not None
    return fit_spin(frames, arc, truth.pan)


@pytest.mark.parametrize("turned", [0.3, 3.1, 3.5, 6.2, 11.0])
def test_the_angle_turned_is_unfolded_by_half_turns_about_the_spin_axis(turned: float) -> None:
    # Rests along z until 0.2 s, then turns about -y.
    rate = turned / 0.7
    start = rotations.exp([0.0, -0.3 * rate, 0.0]) @ UP  # at the origin, 0.3 s after the release
    across = spin(np.array([0.0, -rate, 0.0]), normal0=start)
    assert across.turned(UP, 0.9) == pytest.approx(turned)
    tilted = spin(np.zeros(3), normal0=np.array([math.sin(turned), 0.0, math.cos(turned)]))
    assert math.cos(tilted.turned(UP, 0.9)) == pytest.approx(math.cos(turned))


def test_the_jacobian_is_the_derivative_of_the_residuals() -> None:
    s = np.linspace(-0.2, 0.2, 6)
    targets = rotations.exp(np.outer(s, OMEGA)) @ UP
    problem = _SpinProblem(s, targets, np.full((6, 1), 0.01), UP)
    theta = np.array([0.1, -0.2, *OMEGA, 0.6])
    step = 1e-5
    columns = [
        (problem.residuals(theta + step * row) - problem.residuals(theta - step * row)) / (2 * step)
        for row in np.eye(6)
    ]
    assert problem.jacobian(theta) == pytest.approx(np.array(columns).T, abs=1e-3)


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


def test_frequent_frames_show_one_spin_and_rare_ones_may_hide_a_turn_more_or_less() -> None:
    for gap, whole_turns in ((0.05, [0.0]), (0.1, [0.0, -1.0, 1.0])):
        t = np.arange(6) * gap
        vectors = np.outer(t, [0.0, 4.0, 0.0])
        guesses = _spin_guesses(t, rotations.exp(vectors) @ UP)
        expected = [4.0 + turns * 2.0 * math.pi / gap for turns in whole_turns]
        np.testing.assert_allclose([guess[1] for guess in guesses], expected, rtol=1e-9)
