# SPDX-License-Identifier: Apache-2.0
"""Offset between the clock of the motion capture and the clock of this machine."""

from __future__ import annotations

from collections import deque

OFFSET_WINDOW = 5_000_000_000  # time over which the offset is estimated [ns]


class ClockOffset:
    """Age of frames on receipt: latency plus the offset between the two clocks.

    The window of 5 s does not depend on the frame rate: a tracker that was not scheduled receives
    seconds of late frames at once, which must not count as an offset of the clocks.
    """

    def __init__(self) -> None:
        self._frames: deque[tuple[int, int]] = deque()  # time of receipt, age [ns]

    def add(self, stamp_ns: int, received_ns: int) -> None:
        """Add a frame with its stamp and its time of receipt on the clock of this machine [ns]."""
        frames = self._frames
        frames.append((received_ns, received_ns - stamp_ns))
        while not 0 <= received_ns - frames[0][0] <= OFFSET_WINDOW:
            frames.popleft()

    @property
    def seconds(self) -> float:
        """Smallest age on receipt in absolute value, which is insensitive to jitter [s]."""
        return min((age for _, age in self._frames), key=abs, default=0) * 1e-9
