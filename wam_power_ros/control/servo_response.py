# SPDX-License-Identifier: Apache-2.0
"""How an arm follows positions: a delay, then a low-pass of first order; what a movement tells."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

PERIOD = 0.002  # [s] of the fit, and its resolution
DELAY_MAX, LAG_MAX = 0.2, 0.1  # [s] that are tried
LAG_STEP = 0.005  # [s]
LEFT_MAX = 0.2  # share of the movement, above which this is no servo of such a kind


def followed(q: np.ndarray, period: float, delay: float, lag: float) -> np.ndarray:
    """Path (T, n) [rad] of an arm whose references are q (T, n) [rad], from rest at the first.

    `period` [s] is that of the samples, `delay` and `lag` [s] are those of the servo.
    """
    if lag > 0.0:
        kept = math.exp(-period / lag)
        path = q.copy()
        for before, at in pairwise(path):
            at += kept * (before - at)
        q = path
    if delay == 0.0:
        return q
    t = period * np.arange(len(q))
    return np.stack([np.interp(t - delay, t, column) for column in q.T], axis=1)


class Servo(NamedTuple):
    """A servo and the root mean square of the joints' errors with and without it [rad].

    Attributes:
        delay: Delay [s].
        lag: Time constant of the low-pass [s].
        error: Error that is left [rad].
        error_without: Error of an arm that follows at once [rad].
    """

    delay: float
    lag: float
    error: float
    error_without: float


def servo_of(t: np.ndarray, q: np.ndarray, sent_t: np.ndarray, sent: np.ndarray) -> Servo:
    """Servo that explains a movement best, by least squares over delays and lags.

    Args:
        t: Times of the states [s]. Shape (T,).
        q: Reported positions [rad]. Shape (T, n).
        sent_t: Times of the states that positions answered [s]. Shape (M,).
        sent: These positions [rad]. Shape (M, n).

    Raises:
        ValueError: The arm hardly moved, followed later than is tried, or in another way.
    """
    even = np.arange(max(t[0], sent_t[0]), min(t[-1], sent_t[-1]), PERIOD)
    reached, wanted = (
        np.stack([np.interp(even, times, column) for column in rows.T], axis=1)
        for times, rows in ((t, q), (sent_t, sent))
    )
    latest = round(DELAY_MAX / PERIOD)
    if len(even) <= 2 * latest or float(np.ptp(wanted, axis=0).max()) < 0.1:
        raise ValueError("no joint was moved by 0.1 rad, which a delay cannot be told from")

    def error(late: int, smooth: np.ndarray) -> float:
        left = reached[latest:] - smooth[latest - late : -late or None]
        return float(np.sqrt(np.mean(left**2)))

    lags = np.arange(0.0, LAG_MAX + LAG_STEP, LAG_STEP)
    found = min(
        (error(late, smooth), late * PERIOD, float(lag))
        for lag in lags
        for smooth in [followed(wanted, PERIOD, 0.0, float(lag))]
        for late in range(latest + 1)
    )
    servo = Servo(found[1], found[2], found[0], error(0, wanted))
    moved = float(np.sqrt(np.mean((reached - reached.mean(axis=0)) ** 2)))
    if servo.error > LEFT_MAX * moved:
        raise ValueError(
            f"no delay explains how the arm followed: {servo.error:.3f} rad rms are left of a "
            f"movement of {moved:.3f}"
        )
    if servo.delay >= DELAY_MAX or servo.lag >= LAG_MAX:
        raise ValueError(f"the arm is later than {DELAY_MAX} s, or its servo lags by {LAG_MAX} s")
    return servo
