# SPDX-License-Identifier: Apache-2.0
"""The library without arm, task or ROS."""

import numpy as np
import pytest

import wam_power_ros as power
from wam_power_ros.learning.cma_es import CmaEs

T = np.linspace(0.0, 2.0, 101)
X = np.column_stack([0.3 * np.cos(T), 0.3 * np.sin(T), 0.1 * T])
VIA = np.array([0.25, 0.2, 0.2])


def near(policy: power.Policy) -> float:
    """Return of a movement that shall pass a point."""
    _, x = power.path(policy, X[0])
    return float(np.exp(-10.0 * np.linalg.norm(x - VIA, axis=1).min()))


@pytest.mark.parametrize("duration", [0.4, 20.0])
def test_a_movement_is_reproduced_as_well_whatever_its_tempo(duration: float) -> None:
    t, x = power.path(power.fit(T * duration / 2.0, X), X[0])
    expected = np.column_stack([np.interp(t, T * duration / 2.0, axis) for axis in X.T])
    away = np.linalg.norm(x - expected, axis=1)
    assert away[len(t) // 3 :].max() < 0.01  # it begins at rest, the demonstration does not


def test_times_need_neither_begin_at_zero_nor_be_even() -> None:
    even = power.fit(T, X)
    uneven = np.sort(np.random.default_rng(0).uniform(0.0, 2.0, 400))
    uneven[[0, -1]] = 0.0, 2.0
    sampled = np.column_stack([np.interp(uneven, T, axis) for axis in X.T])
    other = power.fit(uneven + 1e9, sampled)
    np.testing.assert_allclose(power.path(other, X[0])[1], power.path(even, X[0])[1], atol=0.01)


@pytest.mark.parametrize("make", [None, lambda n, rng: CmaEs(n, CmaEs.Settings(), rng)])
def test_practice_improves_the_return_and_the_same_seed_gives_the_same(make: object) -> None:
    more = {} if make is None else {"learner": make}
    policy = power.fit(T, X)
    run, again = (
        [*power.practise(near, policy, np.random.default_rng(0), rollouts=count, **more)]
        for count in (60, 10)
    )
    assert [tried.ret for tried in run[:10]] == [tried.ret for tried in again]
    np.testing.assert_allclose(run[0].ret, near(policy))
    assert near(run[-1].mean) > 1.2 * run[0].ret


@pytest.mark.parametrize(
    ("t", "x", "why"),
    [
        (T, X[:, :2], "x"),
        (T[::-1], X, "t must have"),
        (T, np.where(X == X[3], np.nan, X), "x"),
        (T * 1e-2, X, "at least 24"),
    ],
)
def test_what_is_no_movement_is_refused_by_name(t: np.ndarray, x: np.ndarray, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        power.fit(t, x)
