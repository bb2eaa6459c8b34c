# SPDX-License-Identifier: Apache-2.0
"""An arm that differs from its URDF finds by how much, from one recording of its movement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import true_arm

from wam_power_ros.commissioning import camera_frame
from wam_power_ros.commissioning.measurement import Commissioned, Recording, analyse, begun

PLAN = true_arm.planned()
TRUE = true_arm.truth()


@pytest.fixture(scope="module")
def recorded() -> Recording:
    return true_arm.recording(PLAN, TRUE)


@pytest.fixture(scope="module")
def found(recorded: Recording) -> Commissioned:
    return analyse(true_arm.plain(), PLAN, recorded, payload=float(TRUE.payload[0]))


def test_zeros_and_frame_are_those_of_the_arm(found: Commissioned) -> None:
    assert found.cameras is not None
    assert np.allclose(found.cameras.zeros, TRUE.zeros, atol=np.deg2rad(0.25))
    frame, truth = found.cameras.world_to_base, true_arm.CAMERAS.inverse()
    assert np.allclose(frame.position, truth.position, atol=2e-3)
    assert np.allclose(frame.rotation, truth.rotation, atol=5e-3)
    assert found.check_position < 2e-3
    assert found.check_rotation < np.deg2rad(0.5)
    assert camera_frame.concerns(found.cameras) == []


def test_late_stamps_of_the_cameras_are_measured(found: Commissioned) -> None:
    assert found.latency == pytest.approx(0.003, abs=3e-4)


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
    blind = replace(
        recorded, seen_t=nothing, position=np.empty((0, 3)), rotation=np.empty((0, 3, 3))
    )
    found = analyse(true_arm.plain(), PLAN, blind)
    assert found.cameras is None
    assert not found.arm.corrections.zeros.any()
    assert found.after.slow < found.before.slow


def test_the_beginning_of_the_movement_is_found_in_the_recording(recorded: Recording) -> None:
    rest = np.tile(recorded.q[0], (350, 1))
    t = np.arange(len(recorded.t) + 700) * true_arm.PERIOD
    q = np.vstack([rest, recorded.q, np.tile(recorded.q[-1], (350, 1))])
    assert begun(PLAN, t, q) == pytest.approx(1.4, abs=0.003)


def test_a_recording_that_was_ended_early_is_refused(recorded: Recording) -> None:
    with pytest.raises(ValueError, match="ended early"):
        begun(PLAN, recorded.t[:-1000], recorded.q[:-1000])


def test_a_recording_of_another_movement_is_refused(recorded: Recording) -> None:
    other = true_arm.planned(seed=1)
    shorter = replace(other, t=PLAN.t, q=np.resize(other.q, PLAN.q.shape))
    with pytest.raises(ValueError, match="another one"):
        begun(
            shorter,
            np.append(recorded.t, recorded.t[-1] + 1.0),
            np.vstack([recorded.q, recorded.q[-1:]]),
        )
