# SPDX-License-Identifier: Apache-2.0
"""Smoothing and trimming of joint samples of the WAM."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from wam_power_ros.control.arm import Arm
from wam_power_ros.learning import demonstration
from wam_power_ros.learning.demonstration import (
    MOVEMENT,
    Demonstration,
    Movement,
    from_joint_samples,
    from_positions,
    rotation_from,
    smooth_joints,
)
from wam_power_ros.learning.dmp import acceleration, fit, tabulate
from wam_power_ros.params.resources import share
from wam_power_ros.tasks.flip.settings import FLIP_FIT

HOME = np.radians([0.0, 20.0, 0.0, 115.0, 0.0, -45.0, 0.0])
PERIOD_NS = 2_000_000
HALF = demonstration.half_window(demonstration.CUTOFF)
WHOLE = Movement(start=0.0, end=0.0)
LENGTH = 0.9  # duration of the movement [s]
COUNT = 2.0 * math.pi / 4096 / 20  # resolution of an encoder at the joint [rad]


@pytest.fixture(scope="module")
def arm() -> Arm:
    names = [f"wam_j{i}" for i in range(1, 8)]
    return Arm(share("urdf/wam7.urdf").read_text(encoding="utf-8"), names)


def joints(t: np.ndarray) -> np.ndarray:
    """Dip and flick of joints 4 and 6, at rest outside [0, LENGTH]. Shape (T, 7)."""
    u = np.clip(t / LENGTH, 0.0, 1.0)
    bump = 64.0 * (u * (1.0 - u)) ** 3
    swing = bump * np.sin(2.0 * math.pi * u)
    return HOME + np.outer(swing, [0.0, 0.1, 0.0, 0.25, 0.0, -0.4, 0.0])


def recording(
    before: float = 0.5, after: float = 0.5, seed: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and encoder counts of one demonstration; with a seed, encoders flicker."""
    ticks = np.arange(round(-before * 500), round((LENGTH + after) * 500) + 1)
    stamps = 1_700_000_000_000_000_000 + ticks.astype(np.int64) * PERIOD_NS
    q = joints(ticks * 0.002)
    if seed is not None:
        # A function of the stamp, so that a longer recording holds the same samples.
        rng = np.random.default_rng(seed)
        flicker = rng.uniform(-0.5, 0.5, (10_000, 7)) * COUNT
        q = np.round((q + flicker[ticks + 5000]) / COUNT) * COUNT
    return stamps, q


def same(a: Demonstration, b: Demonstration) -> bool:
    return all(np.array_equal(value, getattr(b, name)) for name, value in vars(a).items())


def test_position_velocity_and_acceleration_are_those_of_the_arm(arm: Arm) -> None:
    demonstration = from_joint_samples(arm, *recording(seed=1), WHOLE)
    t = np.arange(-0.5, LENGTH + 0.5 + 1e-9, 0.002)
    fine = 1e-4
    now, later, earlier = (
        np.array([arm.tool_pose(q)[0] for q in joints(t + shift)]) for shift in (0.0, fine, -fine)
    )
    inner = slice(40, -40)
    speed = (later - earlier) / (2.0 * fine)
    force = (later - 2.0 * now + earlier) / fine**2
    assert np.abs(demonstration.position - now)[inner].max() < 0.0005
    assert np.abs(demonstration.velocity - speed)[inner].max() < 0.02 * np.abs(speed).max()
    assert np.abs(demonstration.acceleration - force)[inner].max() < 0.06 * np.abs(force).max()
    assert np.abs(demonstration.q - joints(t))[inner].max() < 0.002


@pytest.mark.parametrize(("before", "after"), [(0.2, 0.2), (4.0, 2.5)])
def test_trimming_forgets_how_long_the_arm_rested(arm: Arm, before: float, after: float) -> None:
    base = from_joint_samples(arm, *recording(seed=3))
    assert same(from_joint_samples(arm, *recording(before, after, seed=3)), base)
    assert 0.5 * LENGTH < base.duration < LENGTH


def test_an_earlier_smaller_movement_is_left_out(arm: Arm) -> None:
    base = from_joint_samples(arm, *recording(3.0))
    stamps, q = recording(3.0)
    q = q + 0.3 * (joints(np.arange(len(q)) * 0.002 - 0.5) - HOME)
    made = from_joint_samples(arm, stamps, q)
    assert same(replace(made, left_out=()), base)
    ((duration, pause, at, earlier),) = made.left_out
    assert earlier and demonstration.MOMENT <= duration < LENGTH
    assert 3.0 - LENGTH - 0.5 < pause < 3.0 - 0.5 and 2.5 < at + pause + 0.5 < 3.0 + LENGTH


def turn(angle: float, seed: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and encoder counts of a turn of the last joint, about the axis of the tool."""
    stamps, q = recording(seed=seed)
    u = np.clip((np.arange(len(q)) * 0.002 - 0.5) / LENGTH, 0.0, 1.0)
    q = np.tile(q[0], (len(q), 1))
    q[:, 6] += np.round(angle * u**3 * (10.0 - 15.0 * u + 6.0 * u**2) / COUNT) * COUNT
    return stamps, q


def test_a_turn_of_the_tool_is_a_movement_and_is_reproduced(arm: Arm) -> None:
    taught = from_joint_samples(arm, *turn(1.2))
    assert 0.5 * LENGTH < taught.duration < LENGTH and taught.left_out == ()
    policy = fit([taught], FLIP_FIT, "turn")
    middle = math.sqrt(FLIP_FIT.k_min * FLIP_FIT.k_max) * np.eye(3)
    assert policy.stiffness == pytest.approx(np.tile(middle, (FLIP_FIT.count, 1, 1)))
    tables, x, r = tabulate(policy), taught.position[0], np.zeros(3)
    twist, position, rotation = np.zeros(6), [x], [r]
    for k in range(len(taught.t) - 1):
        twist = twist + 0.002 * acceleration(tables, k, x, r, twist)
        x, r = x + 0.002 * twist[:3], r + 0.002 * twist[3:]  # about one axis
        position.append(x)
        rotation.append(r)
    assert np.abs(position - taught.position).max() < 0.001
    wanted = rotation_from(taught.quat_xyzw, taught.quat_xyzw[0])
    assert np.linalg.norm(wanted[-1]) > 1.0
    assert np.abs(rotation - wanted).max() < math.radians(3.0)


def test_a_turn_that_is_too_slow_is_refused_with_both_limits(arm: Arm) -> None:
    with pytest.raises(ValueError, match=r"at least 0\.05 m/s, .* 0\.2 rad/s"):
        from_joint_samples(arm, *turn(0.08))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s, q: (np.where(s == s[7], s[6], s), q), "stamps must increase"),
        (lambda s, q: (s + 60_000_000 * (s >= s[100]), q), "gap of 0.062"),
        (lambda s, q: (s, np.where(np.indices(q.shape)[0] == 9, math.nan, q)), r"q\[9, 0\] = nan"),
        (lambda s, q: (s, q[:, :6]), "q has shape"),
        (lambda s, q: (s, q[:-1]), "q has shape"),
        (lambda s, q: (s * 1e-9, q), "float64"),
        (lambda s, q: (s[:1], q[:1]), "at least two"),
        (lambda s, q: (s[:20], q[:20]), "recording of 20 samples"),
        (lambda s, q: (s, np.tile(HOME, (len(q), 1))), "peak speed"),
    ],
)
def test_a_wrong_recording_is_refused_and_the_fault_named(
    arm: Arm, change: Callable[..., tuple[np.ndarray, np.ndarray]], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        from_joint_samples(arm, *change(*recording()))


def test_positions_alone_make_a_demonstration() -> None:
    t = np.arange(100) * 0.01
    made = from_positions(np.stack([t**2, t, 0.0 * t], axis=1), 0.01)
    assert made.velocity == pytest.approx(np.stack([2.0 * t, t**0, 0.0 * t], axis=1), abs=1e-9)
    assert made.acceleration == pytest.approx(np.tile([2.0, 0.0, 0.0], (100, 1)), abs=1e-6)
    assert made.t == pytest.approx(t) and made.period == 0.01
    for name in ("t", "q", "position", "velocity", "acceleration", "quat_xyzw"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(made, name)[0] = 1.0
    assert not made.q.any() and made.q.shape == (100, 1)
    assert made.quat_xyzw.tolist() == [[0.0, 0.0, 0.0, 1.0]] * 100
    assert from_positions(np.zeros((3, 3)), 0.01).duration == pytest.approx(0.02)
    with pytest.raises(ValueError, match="at least 3"):
        from_positions(np.zeros((2, 3)), 0.01)


def test_smoothing_passes_slow_movement_and_halves_the_power_at_9_hz() -> None:
    t = np.arange(2000) * 0.002
    middle = slice(500, -500)
    for frequency, least, most in ((2.0, 0.995, 1.0), (9.34, 0.70, 0.715), (40.0, 0.0, 0.2)):
        wave = np.sin(2.0 * math.pi * frequency * t)
        smoothed = demonstration._smoothed(wave, HALF)[middle]
        assert least <= smoothed.std() / wave[middle].std() <= most


def test_a_movement_begins_at_15_percent_of_the_peak_speed_and_ends_at_5() -> None:
    rising, falling = np.arange(42) / 42.0, 1.0 - np.arange(203) / 202.0
    slow = np.full(100, 0.04)  # at a peak of 1 [m/s]
    speed = np.concatenate([slow, rising, falling, slow])
    assert demonstration._extent(speed, MOVEMENT) == (100 + 7, 142 + 191)
    assert demonstration._extent(0.05 * speed, MOVEMENT) == (107, 333)


def test_a_turning_point_belongs_to_a_movement_and_a_longer_pause_ends_it() -> None:
    for pause, extent in ((124, (0, 223)), (125, (0, 49))):  # samples of 2 ms
        speed = np.concatenate([np.ones(50), np.zeros(pause), np.full(50, 0.5)])
        assert demonstration._extent(speed, MOVEMENT) == extent
        backwards = demonstration._extent(speed[::-1], MOVEMENT)
        assert backwards == (len(speed) - 1 - extent[1], len(speed) - 1)


def test_a_whole_recording_as_long_as_the_smoothing_reaches_is_smoothed(arm: Arm) -> None:
    t, q = smooth_joints(*recording(seed=1))
    whole = from_joint_samples(arm, *recording(seed=1), WHOLE)
    np.testing.assert_array_equal(t, whole.t)
    np.testing.assert_array_equal(q, whole.q)
    stamps, still = 10**9 + np.arange(57) * PERIOD_NS, np.tile(HOME, (57, 1))  # it need not move
    assert smooth_joints(stamps, still)[1] == pytest.approx(still)
    with pytest.raises(ValueError, match="56 samples"):
        smooth_joints(stamps[:-1], still[:-1])
