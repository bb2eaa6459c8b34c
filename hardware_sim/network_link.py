# SPDX-License-Identifier: Apache-2.0
"""Network link between a device and its topic, with latency, jitter and loss of messages."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np


class Link:
    """Queue whose items arrive in order after random delays, except those that are lost.

    Args:
        latency: Mean delay [s].
        jitter: Standard deviation of the delay, which is cut at 0 [s].
        loss: Share of lost items.
        rng: Generator of losses and delays.
    """

    def __init__(
        self, latency: float, jitter: float, loss: float, rng: np.random.Generator
    ) -> None:
        self._latency, self._jitter, self._loss, self._rng = latency, jitter, loss, rng
        self._in_transit: deque[tuple[int, Any]] = deque()

    def put(self, now_ns: int, item: object) -> None:
        """Send an item at `now_ns` [ns]."""
        if self._rng.random() < self._loss:
            return
        delay = max(0.0, self._latency + self._jitter * self._rng.standard_normal())
        self._in_transit.append((now_ns + round(delay * 1e9), item))

    def take(self, now_ns: int) -> list[Any]:
        """Remove and return the items that have arrived by `now_ns` [ns], in order."""
        arrived = []
        while self._in_transit and self._in_transit[0][0] <= now_ns:
            arrived.append(self._in_transit.popleft()[1])
        return arrived
