# SPDX-License-Identifier: Apache-2.0
"""Ballistic fit with drag to the frames of a flight, against a simulated toss."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_toss import GRAVITY, Toss, capture, toss, without

from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.tasks.flip.ballistic_fit import (
    Arc,
    Crossing,
    find_crossing,
    fit_arc,
    release_time,
)
from wam_power_ros.tasks.flip.flight import DELTA_H
from wam_power_ros.tasks.flip.frames import frames_from_pan


def arc_through(truth: Toss, path: BodyPath) -> Arc:
    arc = fit_arc(frames_from_pan(truth.pan, path))
    assert arc is not None
    return arc


def crossing_of(truth: Toss, path: BodyPath) -> Crossing:
    crossing = find_crossing(arc_through(truth, path), truth.pan, DELTA_H)
    assert crossing is not None
    return crossing


def test_an_arc_falls_with_gravity_and_drag() -> None:
    velocity = np.array([0.4, -0.1, 2.4])
    theta = np.concatenate([[0.6, 0.0, 1.0], velocity, np.zeros(6)])
    arc = Arc(np.zeros(2), np.arange(2), 0.3, theta, np.eye(12), velocity)
    position, v, step = theta[:3].copy(), velocity.copy(), 1e-4
    for _ in range(4000):
        a = -0.3 * np.linalg.norm(v) * v - [0.0, 0.0, GRAVITY]
        position, v = position + step * v + 0.5 * step**2 * a, v + step * a
    # w is integrated along the drag-free parabola: the difference is of second order in the drag.
    vacuum = theta[:3] + 0.4 * velocity - [0.0, 0.0, 0.5 * GRAVITY * 0.4**2]
    assert arc.position(np.array([0.7]))[0] == pytest.approx(position, abs=0.005)
    assert np.linalg.norm(position - vacuum) > 0.03
    assert arc.position(np.array([0.3]))[0] == pytest.approx(theta[:3])


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


def test_the_arc_is_exactly_at_the_height_when_it_crosses_and_falling() -> None:
    rng = np.random.default_rng(17)
    truth = toss(rng, vz=2.4, half_turns=1.0)
    arc = arc_through(truth, capture(truth, rng))
    for delta_h in (0.05, DELTA_H, 0.18):
        crossing = find_crossing(arc, truth.pan, delta_h)
        assert crossing is not None
        level = np.interp(crossing.t, truth.pan.t, truth.pan.position[:, 2]) + delta_h
        assert crossing.position[2] == pytest.approx(level, abs=1e-5)
        assert arc.position(crossing.t - 0.01)[0, 2] > level > arc.position(crossing.t + 0.01)[0, 2]
    assert crossing.apex == pytest.approx(truth.position[:, 2].max(), abs=0.002)


def test_an_arc_that_has_not_come_down_at_the_end_of_the_path_has_no_crossing() -> None:
    rng = np.random.default_rng(17)
    truth = toss(rng, vz=2.4, half_turns=1.0)
    arc, pan = arc_through(truth, capture(truth, rng)), truth.pan
    early = pan.t < truth.t_f - 0.05
    cut = EndEffectorPath("t", pan.t[early], pan.position[early], pan.quat_xyzw[early])
    assert find_crossing(arc, cut, DELTA_H) is None


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
