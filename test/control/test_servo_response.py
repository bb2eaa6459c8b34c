# SPDX-License-Identifier: Apache-2.0
"""How an arm follows positions: found from a movement, and foreseen of a rollout."""

from __future__ import annotations

import numpy as np
import pytest

from wam_power_ros.control.servo_response import followed, servo_of

T = np.arange(0.0, 6.0, 0.002)
Q = np.stack([0.4 * np.sin(2.0 * T) ** 3, 0.2 * np.sin(5.0 * T)], axis=1)


@pytest.mark.parametrize(
    ("delay", "lag", "every"),  # states a set point
    [(0.0, 0.0, 1), (0.04, 0.02, 4), (0.08, 0.04, 1)],
)
def test_delay_and_lag_are_those_of_the_servo(delay: float, lag: float, every: int) -> None:
    noise = np.random.default_rng(1).normal(0.0, 2e-4, Q.shape)
    reached = followed(Q, 0.002, delay, lag) + noise
    jitter = np.random.default_rng(2).uniform(0.0, 0.0004, len(T))
    found = servo_of(T + jitter, reached, T[::every], Q[::every])
    assert (found.delay, found.lag) == pytest.approx((delay, lag), abs=0.0041)
    assert found.error < 1e-3


def test_a_path_begins_at_rest_and_ends_at_its_end() -> None:
    step = np.concatenate([np.zeros((50, 1)), np.ones((450, 1))])
    late = followed(step, 0.002, 0.04, 0.02)[:, 0]
    assert not late[:70].any()
    assert late[80] == pytest.approx(1.0 - np.exp(-1.0), abs=0.04)  # a lag after the delay
    assert late[-1] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("sent", "reached", "words"),
    [
        (Q, -Q, "no delay explains"),
        (Q, followed(Q, 0.002, 0.22, 0.0), "later than"),
        (0.1 * Q, 0.1 * Q, r"no joint was moved by 0\.1 rad"),
    ],
)
def test_an_arm_that_follows_otherwise_has_no_delay(
    sent: np.ndarray, reached: np.ndarray, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        servo_of(T, reached, T, sent)
