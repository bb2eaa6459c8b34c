# SPDX-License-Identifier: Apache-2.0
"""Gaps in the stamps of a topic."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np


class Gaps(NamedTuple):
    """Gaps between the stamps of a topic."""

    period: float  # median interval between messages [s]; 0 without an interval
    missing: int  # number of messages that would fill the intervals longer than 1.5 periods
    longest: float  # longest interval [s]


def gaps(stamps_ns: Sequence[int] | np.ndarray) -> Gaps:
    """Gaps between stamps [ns] as received, shape (M,); those that repeat or go back make none."""
    steps = np.diff(np.asarray(stamps_ns, dtype=np.int64))
    steps = steps[steps > 0]
    if not len(steps):
        return Gaps(0.0, 0, 0.0)
    period = float(np.median(steps))
    missing = np.rint(steps[steps > 1.5 * period] / period) - 1.0
    return Gaps(period * 1e-9, int(missing.sum()), float(steps.max()) * 1e-9)


def device_gaps(
    stamps_ns: Mapping[tuple[str, ...], Sequence[int]], joint_names: Collection[str]
) -> Gaps:
    """Gaps of a topic of one or more devices: of those with joints of the arm, or else of all.

    A device is known by the names of its joints. The period is that of the device with most
    messages; missing messages are summed.
    """
    arm = [each for names, each in stamps_ns.items() if not set(names).isdisjoint(joint_names)]
    found = [(len(each), gaps(each)) for each in arm or stamps_ns.values()]
    if not found:
        return Gaps(0.0, 0, 0.0)
    _, most = max(found)
    return Gaps(most.period, sum(of.missing for _, of in found), max(of.longest for _, of in found))
