# SPDX-License-Identifier: Apache-2.0
"""A link that delays, jitters and loses: what life puts between a device and a topic."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np


class Link:
    """First in, first out, each item after a random delay, some never.

    Args:
        latency: mean delay [s].
        jitter: standard deviation of the delay, which is never negative [s].
        loss: share of items that never arrive.
        rng: makes the losses and delays.
    """

    def __init__(
        self, latency: float, jitter: float, loss: float, rng: np.random.Generator
    ) -> None:
        self._latency, self._jitter, self._loss, self._rng = latency, jitter, loss, rng
        self._under_way: deque[tuple[int, Any]] = deque()

    def put(self, now_ns: int, item: object) -> None:
        """Send an item at `now_ns` [ns]."""
        if self._rng.random() < self._loss:
            return
        delay = max(0.0, self._latency + self._jitter * self._rng.standard_normal())
        self._under_way.append((now_ns + round(delay * 1e9), item))

    def take(self, now_ns: int) -> list[Any]:
        """Items that have arrived by `now_ns` [ns], in order: none overtakes the one before."""
        arrived = []
        while self._under_way and self._under_way[0][0] <= now_ns:
            arrived.append(self._under_way.popleft()[1])
        return arrived
