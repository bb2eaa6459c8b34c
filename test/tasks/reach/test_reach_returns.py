# SPDX-License-Identifier: Apache-2.0
"""Equation 4, the return of reaching."""

from __future__ import annotations

import math

import numpy as np
import pytest

from wam_power_ros.tasks.reach.returns import reaching_return, reaching_terms


def one(path: np.ndarray, demonstrated: np.ndarray, goal: np.ndarray) -> float:
    return float(reaching_return(path[np.newaxis], demonstrated, goal)[0])


def test_equation_4_of_a_perfect_path_is_almost_one() -> None:
    path = np.linspace([0.0, 0.0, 0.0], [0.5, 0.0, 0.0], 200)
    # 199 of the 200 steps earn w1/T, the last earns w2.
    assert one(path, path, path[-1]) == pytest.approx(0.5 * 199 / 200 + 0.5)


def test_equation_4_counts_each_step_by_its_distance() -> None:
    demonstrated = np.zeros((4, 3))
    path = np.array([[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3], [0.4, 0, 0]])
    expected = 0.5 / 4 * sum(math.exp(-d) for d in (1, 2, 3)) + 0.5 * math.exp(-4)
    assert one(path, demonstrated, np.zeros(3)) == pytest.approx(expected)
    following, goal = reaching_terms(path[np.newaxis], demonstrated, np.zeros(3))
    assert goal[0] == pytest.approx(0.5 * math.exp(-4))
    assert following[0] + goal[0] == pytest.approx(expected)


def test_a_path_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="must be"):
        reaching_return(np.zeros((1, 5, 3)), np.zeros((6, 3)), np.zeros(3))
    with pytest.raises(ValueError, match="finite"):
        reaching_return(np.full((1, 5, 3), math.nan), np.zeros((5, 3)), np.zeros(3))
