# SPDX-License-Identifier: Apache-2.0
"""A recording becomes a movement from rest to rest, or is refused with the largest speed."""

from __future__ import annotations

import numpy as np
import pytest
from rigid_arm import LIMITS, NAMES
from scipy.interpolate import CubicSpline

from wam_power_ros.bags import reader
from wam_power_ros.control.modes import ControllerError, Refusal
from wam_power_ros.control.replay_trajectory import EASE_TIME, movement, sampled
from wam_power_ros.params.resources import share

REACH = min(share("bags").glob("reach_*"))
TICK = 2_000_000  # [ns]


def recording(noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Two seconds of a swing that is in motion from the first sample to the last."""
    t = np.arange(1001) * 0.002
    q = np.sin(2.0 * t)[:, None] * np.linspace(0.1, 0.7, 7)
    q += noise * np.random.default_rng(0).standard_normal(q.shape)
    return 1_700_000_000_000_000_000 + TICK * np.arange(1001), q


@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_a_replay_goes_from_rest_to_rest_through_what_was_recorded(speed: float) -> None:
    stamps_ns, q = recording()
    t, followed = movement(stamps_ns, q, speed)
    assert t[0] == 0.0
    assert t[-1] == pytest.approx(2.0 / speed + EASE_TIME)
    np.testing.assert_allclose(followed[[0, -1]], q[[0, -1]], atol=1e-4)
    spline = CubicSpline(t, followed)
    assert np.abs(spline(t[[0, -1]], 1)).max() < 0.02
    fine = spline(np.linspace(0.0, t[-1], 400))
    away = np.abs(fine[:, None] - q[None]).max(axis=2).min(axis=1)
    assert away.max() < 2e-3
    middle = np.abs(t - 0.5 * t[-1]) < 0.25 * t[-1]  # at full speed
    recorded = CubicSpline((stamps_ns - stamps_ns[0]) * 1e-9, q)
    at = (t[middle] - 0.5 * EASE_TIME) * speed
    np.testing.assert_allclose(followed[middle], recorded(at), atol=1e-3)
    np.testing.assert_allclose(spline(t[middle], 1), speed * recorded(at, 1), atol=0.02 * speed)


def test_an_invalid_speed_is_refused() -> None:
    for speed in (0.0, 5.1, np.nan):
        with pytest.raises(ValueError, match="speed"):
            movement(*recording(), speed)


def test_too_fast_a_replay_is_refused_with_the_largest_possible_speed() -> None:
    t, q = movement(*reader.read_demonstration(REACH, NAMES), 1.0)
    with pytest.raises(ControllerError, match="times a joint-speed limit") as refused:
        sampled(t / 8.0, q, 0.002, LIMITS)
    assert refused.value.refusal is Refusal.TOO_FAST
    possible = 8.0 * refused.value.speed
    assert 1.0 < possible < 8.0
    assert np.abs(sampled(t / (0.995 * possible), q, 0.002, LIMITS).qd / LIMITS.qd_max).max() < 1
    with pytest.raises(ControllerError):
        sampled(t / (1.005 * possible), q, 0.002, LIMITS)
    for wrong, text in ((q[:, :6], "6 joints"), (q[:3], "N >= 4")):
        with pytest.raises(ControllerError, match=text):
            sampled(t, wrong, 0.002, LIMITS)


@pytest.mark.requirement("S-16")
@pytest.mark.parametrize("joint", [0, 6])
def test_one_joint_beyond_its_limit_or_too_fast_in_either_direction_is_enough(joint: int) -> None:
    t = np.linspace(0.0, 1.0, 101)
    still = np.tile(0.5 * (LIMITS.q_min + LIMITS.q_max), (101, 1))
    swing = 10.0 * t**3 - 15.0 * t**4 + 6.0 * t**5
    for limit, sign in ((LIMITS.q_min, -1.0), (LIMITS.q_max, 1.0)):
        at, fast = still.copy(), still.copy()
        at[:, joint] = limit[joint]
        assert sampled(t, at, 0.002, LIMITS).duration == 1.0
        at[:, joint] += 1e-6 * sign
        with pytest.raises(ControllerError, match="joint limits"):
            sampled(t, at, 0.002, LIMITS)
        room = 0.9 * abs(limit[joint] - still[0, joint])
        fast[:, joint] += sign * room * swing
        speed = 1.1 * LIMITS.qd_max[joint] / (1.875 * room)
        with pytest.raises(ControllerError, match=r"1\.10 times a joint-speed limit"):
            sampled(t / speed, fast, 0.002, LIMITS)
