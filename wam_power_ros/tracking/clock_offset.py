# SPDX-License-Identifier: Apache-2.0
"""Offset between the clock that stamps frames and the one that receives them."""

from __future__ import annotations

from collections import deque

OFFSET_WINDOW = 5_000_000_000  # frames from which the offset is estimated [ns]


class ClockOffset:
    """Delay of frames after their stamps: their latency, and the offset between two clocks.

    Estimated over the frames of the last 5 s at any rate: a tracker that was not scheduled finds
    seconds of frames that are all late, which must not count as an offset of the clocks.
    """

    def __init__(self) -> None:
        self._frames: deque[tuple[int, int]] = deque()  # receipt, age [ns]

    def add(self, stamp_ns: int, received_ns: int) -> None:
        """Add a frame with its stamp and its time of receipt by this machine's clock [ns]."""
        frames = self._frames
        frames.append((received_ns, received_ns - stamp_ns))
        while not 0 <= received_ns - frames[0][0] <= OFFSET_WINDOW:
            frames.popleft()

    @property
    def seconds(self) -> float:
        """Age nearest to 0 on receipt, which jitter does not change [s]."""
        return min((age for _, age in self._frames), key=abs, default=0) * 1e-9
