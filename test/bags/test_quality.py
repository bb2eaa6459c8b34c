# SPDX-License-Identifier: Apache-2.0
"""Grades of movements: a smooth, complete movement within the limits is good."""

from __future__ import annotations

import numpy as np
import pytest

from wam_power_ros.bags import layout, quality
from wam_power_ros.bags.quality import Grade, Limits

T = np.arange(0.0, 2.0, 0.01)
NAMES = ("j1", "j2")
WIDE = Limits(np.full(2, -3.0), np.full(2, 3.0), np.full(2, 2.0))


def reach(size: float = 1.0) -> np.ndarray:
    """A movement of least jerk, of one joint."""
    s = np.clip((T - 0.3) / 1.2, 0.0, 1.0)
    return np.stack([size * (10 * s**3 - 15 * s**4 + 6 * s**5), 0.0 * T], axis=1)


def remarks(q: np.ndarray, limits: Limits | None = WIDE) -> list[quality.Remark]:
    return quality.movement_remarks(T, q, NAMES, limits)


def arc(q: np.ndarray) -> float:
    return quality.smoothness(np.linalg.norm(quality.joint_speeds(T, q), axis=1), 0.01)


def test_the_more_a_hand_trembles_the_less_smooth_the_movement() -> None:
    arcs = [arc(reach() + a * np.sin(2 * np.pi * 5 * T)[:, None]) for a in (0.0, 0.02, 0.04)]
    assert arcs == sorted(arcs, reverse=True)
    assert -2.0 < arcs[0] < -1.3  # as published for movements of least jerk


def test_a_smooth_movement_is_good_a_jerky_one_fair_and_an_arm_that_rests_poor() -> None:
    assert remarks(reach()) == []
    assert quality.grade([]) is Grade.GOOD
    found = remarks(reach() + 0.05 * np.sin(2 * np.pi * 5 * T)[:, None], None)
    assert quality.grade(found) is Grade.FAIR and found[0].text.startswith("jerky")
    (found,) = remarks(0.01 * reach())
    assert found.grade is Grade.POOR


@pytest.mark.parametrize(
    ("limits", "grade", "said"),
    [
        (WIDE._replace(q_max=np.array([1.01, 3.0])), Grade.FAIR, "j1 at its position limit"),
        (WIDE._replace(q_max=np.array([0.9, 3.0])), Grade.POOR, "j1 beyond its position limit"),
        (WIDE._replace(qd_max=np.array([1.6, 2.0])), Grade.FAIR, "j1 at 98% of its speed limit"),
        (WIDE._replace(qd_max=np.array([1.0, 2.0])), Grade.POOR, "j1 at 156% of its speed limit"),
    ],
)
def test_what_comes_near_a_limit_is_named(limits: Limits, grade: Grade, said: str) -> None:
    (found,) = remarks(reach(), limits)
    assert (found.grade, found.text) == (grade, said)


def test_angles_in_degrees_are_asked_about_where_limits_are_known() -> None:
    with pytest.raises(ValueError, match=r"j1 is at 40 rad.*degrees"):
        remarks(40.0 * reach())
    assert remarks(40.0 * reach(), None) == []


def test_gaps_are_counted_in_periods_and_stamps_that_repeat_or_go_back_make_none() -> None:
    found = quality.gaps(2_000_000 * np.array([0, 1, 2, 2, 3, 6, 7, 8, 20, 19]))
    assert (found.period, found.missing, found.longest) == (0.002, 2 + 11, 0.024)
    assert quality.gaps([]) == quality.gaps([1]) == quality.Gaps(0.0, 0, 0.0)


def test_what_a_recording_lacks_is_named_from_a_share_on() -> None:
    counts = {"/joint_states": 900, "/pose": 50}
    assert quality.completeness_remarks(counts, {"/joint_states": 10, "/pose": 2}, "") == []
    (found,) = quality.completeness_remarks(counts, {"/joint_states": 100, "/pose": 0}, "")
    assert found.text == "100 of 1000 messages missing on /joint_states"
    assert quality.completeness_remarks({}, {}, layout.STOP_REQUESTED) == []
    (found,) = quality.completeness_remarks({}, {}, "shutdown")
    assert (found.grade, found.text) == (Grade.FAIR, "cut short: shutdown")
