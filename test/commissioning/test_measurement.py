# SPDX-License-Identifier: Apache-2.0
"""An arm that differs from its URDF finds by how much, from one recording of its movement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import true_arm

from wam_power_ros.commissioning.measurement import Commissioned, Recording, Seen, analyse, begun

PLAN = true_arm.planned()
TRUE = true_arm.truth()
ASIDE = 0.004 * np.array([0.6, 0.8, 0.0])


@pytest.fixture(scope="module")
def recorded() -> Recording:
    return true_arm.recorded()


@pytest.fixture(scope="module")
def found() -> Commissioned:
    return true_arm.commissioned()


def test_zeros_frame_and_delay_are_those_of_the_arm_and_its_cameras(found: Commissioned) -> None:
    cameras = found.cameras.frame
    assert np.allclose(cameras.zeros, TRUE.zeros, atol=np.deg2rad(0.25))
    frame, truth = cameras.world_to_base, true_arm.CAMERAS.inverse()
    assert np.allclose(frame.position, truth.position, atol=2e-3)
    assert np.allclose(frame.rotation, truth.rotation, atol=5e-3)
    assert cameras.upright == pytest.approx(np.hypot(0.01, 0.012), abs=2e-3)
    assert 0.0 < found.cameras.check_position < 2e-3
    assert 0.0 < found.cameras.check_rotation < np.deg2rad(0.2)
    assert 0.0 < found.cameras.sweep_position < 1e-3
    assert found.cameras.sweep_rotation < np.deg2rad(0.1)
    assert found.cameras.not_visible == ()
    assert found.cameras.latency == pytest.approx(0.003, abs=3e-4)
    assert abs(found.cameras.latency_change) < 3e-4


def test_torque_constants_friction_tilt_and_payload_are_found(found: Commissioned) -> None:
    c = found.arm.corrections
    used = slice(0, 6)  # the last motor moves next to nothing
    assert np.allclose(c.torque_scales[used], TRUE.torque_scales[used], atol=0.04)
    assert np.allclose(c.coulomb_friction[used] / TRUE.coulomb_friction[used], 1.0, atol=0.1)
    assert np.allclose(c.base_tilt, TRUE.base_tilt, atol=np.deg2rad(0.2))
    # Along the forearm the payload cannot be told well from the scales of the wrist's motors.
    assert np.all(np.abs(c.payload[1:] - TRUE.payload[1:]) < 3.0 * found.arm.moment_sd)
    assert np.abs(c.payload[1:] - TRUE.payload[1:]).max() < 0.009 * 0.76  # 9 mm
    assert c.link_masses[-1] == pytest.approx(1.0, abs=1e-3)  # the tool's part is the payload
    assert found.arm.loop_delay == pytest.approx(0.004, abs=0.002)


def test_friction_that_differs_by_direction_and_speed_is_found(found: Commissioned) -> None:
    c, used = found.arm.corrections, slice(0, 5)
    assert np.allclose(c.friction_asymmetry[used], TRUE.friction_asymmetry[used], atol=0.03)
    assert np.allclose(c.low_speed_friction[used], TRUE.low_speed_friction[used], atol=0.1)
    even = replace(c, friction_asymmetry=np.zeros(7), low_speed_friction=np.zeros(7))
    qd = np.array([0.04, -0.04, 0.04, 0.04, -0.04, 0.04, 0.04])
    arm, without, true = (true_arm.plain().corrected(each) for each in (c, even, TRUE))
    errors = [
        np.abs(a.friction_torque(qd) - true.friction_torque(qd))[used] for a in (arm, without)
    ]
    assert np.all(errors[0] < errors[1])


def test_movements_that_were_not_used_are_explained_several_times_better(
    found: Commissioned,
) -> None:
    for name in ("rest", "slow", "fast"):
        assert getattr(found.after, name) < 0.34 * getattr(found.before, name), name


def test_without_a_body_in_view_the_torques_are_still_used(recorded: Recording) -> None:
    nothing = np.empty(0)
    parts = {"position": np.empty((0, 3)), "rotation": np.empty((0, 3, 3))}
    found = analyse(true_arm.plain(), PLAN, replace(recorded, seen_t=nothing, **parts))
    assert found.cameras is None
    assert not found.arm.corrections.zeros.any()
    assert found.after.slow < found.before.slow


def test_the_mass_by_the_torques_alone_is_found_although_another_one_was_told(
    recorded: Recording,
) -> None:
    told = analyse(true_arm.plain(), PLAN, recorded, payload=float(TRUE.payload[0]) + 0.3).arm
    assert told.corrections.payload[0] == pytest.approx(TRUE.payload[0] + 0.3, abs=0.01)
    assert abs(told.felt_payload - TRUE.payload[0]) < 2.0 * told.felt_sd < 0.1


def seen_of(recorded: Recording, wrong: np.ndarray, by: np.ndarray) -> Seen:
    """What is found of the cameras if the body was seen elsewhere (3,) [m] at these poses (N,)."""
    moved = replace(recorded, position=recorded.position + wrong[:, None] * by)
    return analyse(true_arm.plain(), PLAN, moved).cameras


def test_a_camera_that_is_knocked_after_the_postures_is_seen_in_the_sweeps(
    recorded: Recording, found: Commissioned
) -> None:
    later = recorded.seen_t - recorded.seen_t[0] > PLAN.rests[-1, 1]
    seen = seen_of(recorded, later, ASIDE)
    assert seen.check_position == pytest.approx(found.cameras.check_position, abs=1e-4)
    assert seen.sweep_position == pytest.approx(0.004, abs=0.0015)


def test_rests_without_the_body_in_view_are_named_and_rejected_ones_keep_their_number(
    recorded: Recording,
) -> None:
    t = recorded.seen_t - recorded.t[0]
    hidden = np.logical_or.reduce([(t > a) & (t < b) for a, b in PLAN.rests[[2, 3, 25]]])
    wrong = (t > PLAN.rests[7, 0]) & (t < PLAN.rests[7, 1])
    parts = {name: getattr(recorded, name)[~hidden] for name in ("seen_t", "position", "rotation")}
    seen = seen_of(replace(recorded, **parts), wrong[~hidden], 0.03 * np.ones(3))
    assert seen.not_visible == (2, 3, 25)
    assert seen.frame.rejected == (7,)
    assert seen.fit_position < 0.001  # without it


def test_cameras_that_saw_nothing_of_a_sweep_leave_its_error_open(recorded: Recording) -> None:
    early = recorded.seen_t - recorded.t[0] < PLAN.sweeps[3, 0]
    parts = {name: getattr(recorded, name)[early] for name in ("seen_t", "position", "rotation")}
    seen = analyse(true_arm.plain(), PLAN, replace(recorded, **parts)).cameras
    assert np.isnan([seen.latency_change, seen.sweep_position, seen.sweep_rotation]).all()


def test_the_beginning_of_the_movement_is_found_in_the_recording(recorded: Recording) -> None:
    rest = np.tile(recorded.q[0], (350, 1))
    t = np.arange(len(recorded.t) + 700) * true_arm.PERIOD
    q = np.vstack([rest, recorded.q, np.tile(recorded.q[-1], (350, 1))])
    assert begun(PLAN, t, q) == pytest.approx(1.4, abs=0.003)


def test_a_recording_of_another_movement_or_one_that_was_ended_early_is_refused(
    recorded: Recording,
) -> None:
    with pytest.raises(ValueError, match="ended early"):
        begun(PLAN, recorded.t[:-1000], recorded.q[:-1000])
    other = true_arm.planned(seed=1)
    shorter = replace(other, t=PLAN.t, q=np.resize(other.q, PLAN.q.shape))
    t, q = np.append(recorded.t, recorded.t[-1] + 1.0), np.vstack([recorded.q, recorded.q[-1:]])
    with pytest.raises(ValueError, match="another one"):
        begun(shorter, t, q)
