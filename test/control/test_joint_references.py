# SPDX-License-Identifier: Apache-2.0
"""Joint references are smooth, end where they should, and follow one another without a step."""

import numpy as np
import pytest
from rigid_arm import HOME

from wam_power_ros.control.joint_references import (
    Brake,
    MinJerk,
    ReferenceSequence,
    Sampled,
    interpolated,
)

LOW, HIGH = HOME - 3.0, HOME + 3.0
MS = 1_000_000


def brake(q: np.ndarray, qd: np.ndarray) -> Brake:
    return Brake(q, qd, 0.15, LOW, HIGH)


@pytest.mark.parametrize("out", [1.0, -1.0])
def test_no_brake_ends_beyond_a_joint_limit_or_further_out(out: float) -> None:
    q, limit = HOME.copy(), HIGH if out > 0.0 else LOW
    q[5], q[4] = limit[5] + 0.01 * out, limit[4] - 0.02 * out
    end = brake(q, np.full(7, 3.0 * out)).at(1.0)[0]
    assert end[5] == q[5] and end[4] == limit[4] and np.all(out * (end - q)[:4] > 0.1)
    back = brake(q, np.full(7, -3.0 * out)).at(1.0)[0]
    assert back[5] == pytest.approx(q[5] - 0.5 * 0.15 * 3.0 * out)
    slow, _, _ = brake(HOME, 0.04 * out * np.ones(7)).at(1.0)
    assert np.array_equal(slow, HOME)  # a joint that hardly moves keeps its position


@pytest.mark.parametrize("make_reference", ["min_jerk", "brake", "sampled"])
def test_speed_and_acceleration_of_a_reference_are_its_derivatives(make_reference: str) -> None:
    target = HOME + np.linspace(0.5, -0.5, 7)
    t = np.linspace(0.0, 1.0, 501)
    recorded = HOME + np.sin(3.0 * t)[:, None] * np.linspace(0.1, 0.5, 7)
    reference = {
        "min_jerk": MinJerk(HOME, target, 0.6),
        "brake": Brake(HOME, target, 0.15, HOME - 9.0, HOME + 9.0),
        "sampled": interpolated(t / 0.8, recorded, 0.002),
    }[make_reference]
    grid = np.arange(1, round(reference.duration / 0.002)) * 0.002
    q, qd, qdd = (np.array(rows) for rows in zip(*map(reference.at, grid), strict=True))
    scale = np.abs(qdd).max()
    assert np.allclose(np.gradient(q, 0.002, axis=0)[1:-1], qd[1:-1], atol=1e-3 * scale)
    assert np.allclose(np.gradient(qd, 0.002, axis=0)[1:-1], qdd[1:-1], atol=0.02 * scale)
    assert np.array_equal(reference.at(1e9)[0], reference.at(reference.duration)[0])


def test_a_sequence_goes_from_move_to_replay_to_brake_without_a_jump() -> None:
    t = np.linspace(0.0, 1.0, 101)
    recorded = HOME + 0.2 * np.sin(2.0 * t)[:, None] * np.ones(7)
    sequence = ReferenceSequence(brake)
    away = HOME + 0.31
    sequence.begin(lambda q: MinJerk(q, recorded[0], 0.5), interpolated(t, recorded, 0.002))
    assert sequence.reference is None
    rows, kinds = [], []
    for k in range(1500):
        rows.append(sequence.at(10**12 + k * 2 * MS, away, np.zeros(7)))
        kinds.append(type(sequence.reference))
    assert [*dict.fromkeys(kinds)] == [MinJerk, Sampled, Brake]
    q = np.array([row[0] for row in rows])
    assert np.array_equal(q[0], away)  # begins at the arm's posture
    assert np.abs(np.diff(q, axis=0)).max() < 1.02e-3  # 0.5 rad/s, then 0.4
    assert sequence.ended and np.array_equal(q[-1], q[-2])  # at rest bit for bit


@pytest.mark.parametrize(
    ("t", "q", "rule"),
    [
        (np.arange(3.0), np.zeros((3, 7)), "N >= 4"),
        (np.arange(5.0)[::-1], np.zeros((5, 7)), "increase"),
        (np.arange(5.0), np.full((5, 7), np.nan), "finite"),
        (np.arange(5.0) * 150.01, np.zeros((5, 7)), "600"),
    ],
)
def test_an_invalid_movement_is_refused(t: np.ndarray, q: np.ndarray, rule: str) -> None:
    with pytest.raises(ValueError, match=rule):
        interpolated(t, q, 0.002)


def test_a_recorded_movement_may_begin_at_any_stamp_and_take_ten_minutes() -> None:
    t = np.linspace(0.0, 2.0, 51)
    q = np.sin(1.5 * t)[:, None] * np.ones(7)
    there, later = (interpolated(t + since, q, 0.002) for since in (0.0, 7.0))
    assert later.duration == pytest.approx(there.duration) and there.duration == 2.0
    np.testing.assert_allclose(later.q, there.q, atol=1e-9)
    for before in (-1.0, 0.0, 0.0009):  # also before its beginning
        assert np.array_equal(there.at(before)[0], there.q[0])
    assert np.array_equal(there.at(0.0011)[0], there.q[1])
    assert interpolated(np.arange(5.0) * 150.0, np.zeros((5, 7)), 0.1).duration == 600.0


def test_a_move_and_a_brake_end_bit_for_bit_at_rest_in_their_last_instant() -> None:
    way = np.linspace(-0.7, 0.9, 7) / 3.0
    move, stop = MinJerk(HOME, HOME + way, 0.7), brake(HOME, way)
    for reference, end in ((move, HOME + way), (stop, stop.at(9.0)[0])):
        q, qd, qdd = reference.at(reference.duration)
        assert np.array_equal(q, end) and not qd.any() and not qdd.any()
        for early, first in zip(reference.at(-0.3), reference.at(0.0), strict=True):
            assert np.array_equal(early, first)  # it does not move before it begins
