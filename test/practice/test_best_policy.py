# SPDX-License-Identifier: Apache-2.0
"""The best policy is chosen by its runs without exploration, and by how many there are."""

import numpy as np
import pytest

from wam_power_ros.practice.past import Runs


def run(name: str, returns: list[float]) -> Runs:
    runs = Runs(name, "demonstration-1", np.zeros(3))
    for ret in returns:
        runs.add(ret, succeeded=True)
    return runs


@pytest.mark.parametrize(
    ("returns", "noise", "bound"),
    [
        ([0.6], 0.2, 0.4),
        ([0.5, 0.7, 0.6, 0.6], 0.2, 0.5),  # 0.2 / sqrt(4)
        ([0.3] * 100, 0.5, 0.25),
        ([0.2, 0.4], 0.0, 0.3),
    ],
)
def test_the_lower_bound_is_the_mean_minus_its_standard_error(
    returns: list[float], noise: float, bound: float
) -> None:
    runs = run("trial-0001", returns)
    assert runs.lower_bound(noise) == pytest.approx(bound)


def test_more_runs_count_more_than_one_that_was_lucky() -> None:
    once, often = run("once", [0.68]), run("often", [0.6] * 4)
    assert often.lower_bound(0.2) > once.lower_bound(0.2)
    assert once.lower_bound(0.05) > often.lower_bound(0.05)
