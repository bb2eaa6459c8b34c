# SPDX-License-Identifier: Apache-2.0
"""Where a ball comes down onto the cup, as far as camera frames tell."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.tasks.ball_in_cup.swing import (
    GAP_MAX,
    GRAVITY,
    PLANE,
    STRING,
    landing,
    observe_swing,
    swing_of,
)

FRAME, END, T_C = 1.0 / 30.0, 3.0, 2.0  # [s]
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def a_cup(velocity: float = 0.0) -> EndEffectorPath:
    """An upright cup that moves along x."""
    t = np.arange(0.0, END + 1e-9, 0.002)
    position = np.stack([0.5 + velocity * t, 0.0 * t, 0.8 + 0.0 * t], axis=1)
    return EndEffectorPath("swing", t, position, np.tile(UPRIGHT, (len(t), 1)))


def a_fall(
    cup: EndEffectorPath,
    miss: tuple[float, float],
    speed: float = -2.0,
    begin: float = 0.0,
    caught: bool = True,
) -> BodyPath:
    """Frames of a ball that falls freely through `PLANE` at T_C, and then lies or hangs still."""
    t = np.arange(begin, END, FRAME)
    at = np.array([0.5 + np.interp(T_C, cup.t, cup.position[:, 0] - 0.5), 0.0, 0.8 + PLANE])
    since = t - T_C
    position = at + [*miss, 0.0] + since[:, np.newaxis] * [0.4, -0.2, speed]
    position[:, 2] -= 0.5 * GRAVITY * since**2
    rests = np.array([0.0, 0.0, 0.02] if caught else [0.0, 0.0, -STRING])
    after = since > 0.003  # when it has passed the plane at a step of the observation
    position[after] = cup.position[-1] + rests
    return BodyPath("swing", t, position, np.tile(UPRIGHT, (len(t), 1)))


@settings(max_examples=30)
@given(
    st.floats(-0.3, 0.3),
    st.floats(-0.3, 0.3),
    st.floats(-3.0, -1.5),
    st.floats(0.0, FRAME),
    st.floats(-0.5, 0.5),
)
def test_a_fall_is_measured_between_frames_whatever_the_cup_does_to_the_ball_afterwards(
    x: float, y: float, speed: float, begin: float, velocity: float
) -> None:
    cup = a_cup(velocity)
    swing = observe_swing(cup, a_fall(cup, (x, y), speed, begin, caught=x > 0.0))
    assert swing is not None and swing.t_c == pytest.approx(T_C, abs=0.002)
    assert swing.caught == (x > 0.0)
    assert swing.miss == pytest.approx((x, y), abs=0.002)


def test_a_fall_or_an_end_that_the_cameras_missed_is_not_judged() -> None:
    cup = a_cup()
    whole = a_fall(cup, (0.0, 0.0))
    for kept, judged in (
        (np.abs(whole.t - T_C) > 0.1 * GAP_MAX, True),
        (np.abs(whole.t - T_C) > 1.2 * GAP_MAX, False),
        (whole.t < END - 0.5, False),
        (whole.t < FRAME, False),
    ):
        seen = BodyPath("swing", whole.t[kept], whole.position[kept], whole.quat_xyzw[kept])
        assert (observe_swing(cup, seen) is not None) is judged


def test_a_ball_that_never_rises_above_the_rim_has_a_height_and_no_landing() -> None:
    cup = a_cup()
    t = np.arange(0.0, END, FRAME)
    low = np.tile(cup.position[0] + [0.0, 0.0, -0.1], (len(t), 1))
    swing = observe_swing(cup, BodyPath("swing", t, low, np.tile(UPRIGHT, (len(t), 1))))
    assert swing is not None and swing.t_c is None and swing.distance == np.inf
    assert swing.apex == pytest.approx(-0.1 - PLANE, abs=0.002)
    assert swing_of(swing.to_json()) == swing


def passes(*beside: float) -> np.ndarray:
    """Ball above the plane and below it in turn, at these distances from the cup."""
    rows = [[x, 0.0, height] for x in beside for height in (0.01, -0.01)]
    return np.array([[0.0, 0.0, -STRING], *rows])


@pytest.mark.parametrize(
    ("beside", "counts"),
    [
        ((0.02,), 0),
        ((0.07, 0.01), 0),  # from the rim into the cup
        ((-0.35, 0.03, 0.01), 1),  # a large swing passes beside the cup first
        ((-0.35, 0.2, -0.3), 1),
    ],
)
def test_the_first_pass_that_touches_the_cup_counts_or_else_the_nearest(
    beside: tuple[float, ...], counts: int
) -> None:
    assert landing(passes(*beside)) == 2 * counts + 2
