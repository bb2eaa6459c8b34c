# SPDX-License-Identifier: Apache-2.0
"""Encoders and motion capture."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated import CALM, LEVEL, begin, run

from hardware_sim.motors import motor_motion
from hardware_sim.scenes.flip import Flip
from hardware_sim.sensors import Encoders, Mocap, MocapFrame, MocapSettings
from hardware_sim.wam import PERIOD, PERIOD_NS
from hardware_sim.world import World
from wam_power_ros import rotations
from wam_power_ros.tracking.marker_fit import LAYOUT


def test_encoders_count_and_the_velocity_follows_through_its_filter() -> None:
    encoders = Encoders("wam", PERIOD)
    q, qd = LEVEL.copy(), np.array([0.1, -0.3, 0.2, 0.7, -0.5, 1.1, 2.3])
    encoders.reset(q.tolist())
    seen = []
    for _ in range(100):
        q = q + PERIOD * qd
        encoders.read(q.tolist())
        counts = np.array(motor_motion(encoders.q)) * 4096 / math.tau
        np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
        seen.append(encoders.qd)
    resolution = np.array([3.65, 2.72, 4.56, 8.52, 7.91, 7.91, 10.27]) * 1e-5
    assert (np.abs(np.array(encoders.q) - q) <= 1.01 * resolution).all()
    late = np.array(seen)[50:]
    np.testing.assert_allclose(late.mean(axis=0), qd, atol=3e-3)
    # noise of differenced counts after the 180 rad/s filter, some mrad/s
    assert (late.std(axis=0) < 0.02).all()
    assert late.std(axis=0).max() > 5e-4
    # a step of the velocity has risen to 1 - 1/e after 1/180 s
    rise = np.array(seen)[:, 6] / qd[6]
    assert np.interp(1 - math.exp(-1), rise[:10], PERIOD * np.arange(1, 11)) == pytest.approx(
        1 / 180, abs=1e-3
    )


def filmed(world: World, seconds: float) -> list[tuple[int, MocapFrame]]:
    """Frames of a pancake at rest, each with its time of delivery."""
    gravity = begin(world)
    frames = []
    for _ in range(round(seconds / PERIOD)):
        world.step(gravity)
        frames += [(world.time_ns, frame) for frame in world.mocap_frames()]
    return frames


def test_frames_arrive_at_the_frame_rate_after_the_latency() -> None:
    world = World(Flip, CALM, mocap=MocapSettings(rate=30.0, latency=0.04, dropout=0.0))
    frames = filmed(world, 2.0)
    stamps = np.array([frame.stamp_ns for _, frame in frames])
    late = np.array([now for now, _ in frames]) - stamps
    assert len(frames) == pytest.approx(59, abs=1)
    assert set(late.tolist()) == {40_000_000}
    assert (np.abs(np.diff(stamps) - 1e9 / 30) <= PERIOD_NS).all()


def test_frames_are_as_noisy_as_their_markers() -> None:
    world = World(Flip, CALM, mocap=MocapSettings(rate=250.0, noise=0.0005, dropout=0.0))
    world.reset("trial-0001", LEVEL)  # frozen
    run(world, None, 1000)
    frames = world.mocap_frames()
    truth = world.data.qpos[7:10]
    errors = np.array([frame.position for frame in frames]) - truth
    markers = np.array([frame.markers for frame in frames])
    assert np.abs(errors.mean(axis=0)).max() < 1e-4
    np.testing.assert_allclose(markers.std(axis=0), 0.0005, rtol=0.25)
    assert 0.0002 < errors.std() < 0.0005  # mean of four markers, plus the lever to the centre
    np.testing.assert_allclose(np.linalg.norm([f.quat_xyzw for f in frames], axis=1), 1.0)
    spacing = np.linalg.norm(markers[:, 0] - markers[:, 1], axis=1).mean()
    assert spacing == pytest.approx(np.linalg.norm(LAYOUT[0] - LAYOUT[1]), abs=2e-4)


def test_frames_and_markers_are_lost_at_the_configured_rates() -> None:
    mocap = MocapSettings(rate=250.0, dropout=0.2, occlusion=0.3)
    frames = [frame for _, frame in filmed(World(Flip, CALM, mocap=mocap), 2.0)]
    assert len(frames) == pytest.approx(0.8 * 490, rel=0.12)
    hidden = sum(len(frame.markers) == 3 for frame in frames)
    assert hidden / len(frames) == pytest.approx(0.3, abs=0.08)


def test_a_camera_sees_either_side_of_a_disc_and_nothing_of_one_that_is_edge_on() -> None:
    pytest.importorskip("cv2")
    mocap = Mocap(MocapSettings(camera=True, latency=0.0))
    mocap.aim(np.array([0.8, -0.2, 0.5]))
    mocap.restart(1, np.random.default_rng(0))
    place, twist = np.array([0.8, -0.2, 0.5]), np.array([0.5, 0.0, 1.0, 0.0, 7.0, 0.0])
    off, turned = [], []
    for number in range(13):
        now_ns = (number + 1) * 1_000_000_000
        rotation = rotations.exp(np.array([0.0, number * np.pi / 12, 0.0]))
        mocap.expose(now_ns, place, rotation, twist)
        for frame in mocap.delivered(now_ns):
            off.append(np.linalg.norm(frame.position - place))
            error = rotations.matrix(frame.quat_xyzw) @ rotation.T
            turned.append(np.linalg.norm(rotations.log(error)))
            assert len(frame.markers) == 0
    assert 9 <= len(off) < 13
    assert np.median(off) < 1e-3 and max(off) < 5e-3
    assert max(turned) < np.deg2rad(2.0)


def test_a_camera_sees_a_ball_that_swings_and_tells_a_marker_of_it() -> None:
    pytest.importorskip("cv2")
    mocap = Mocap(MocapSettings(camera=True, single_marker=True, latency=0.0))
    mocap.aim(np.array([0.8, -0.2, 0.5]))
    mocap.restart(1, np.random.default_rng(0))
    rng, off = np.random.default_rng(1), []
    for number in range(20):
        now_ns = (number + 1) * 1_000_000_000
        place = np.array([0.8, -0.2, 0.5]) + rng.uniform(-0.3, 0.3, 3)
        mocap.expose(now_ns, place, np.eye(3), np.array([*rng.uniform(-1.0, 1.0, 3), 0, 0, 0]))
        (frame,) = mocap.delivered(now_ns)
        assert frame.markers.tolist() == [frame.position.tolist()]
        off.append(np.abs(frame.position - place))
    assert (np.median(off, axis=0) < [0.02, 0.05, 0.02]).all()  # least along the view, y
