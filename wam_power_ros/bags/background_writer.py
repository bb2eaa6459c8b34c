# SPDX-License-Identifier: Apache-2.0
"""Writes a bag in a separate thread, so that the subscriber never waits for the disk.

The thread inherits the scheduling of the thread that begins the recording. Both need the
interpreter's lock: a low-priority thread preempted while holding it would delay the subscriber.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rosbags.interfaces import Qos

from wam_power_ros.bags.writer import BagWriter

WRITE_PERIOD = 0.3  # between two flushes; a kill loses the messages of about this time [s]
WAITING_MAX = 100_000  # queued messages; a disk that hangs for minutes counts as full


class Recording:
    """One bag being written; only `close` completes it and makes it the folder `path`."""

    def __init__(
        self, path: Path, kind: str, notes: Mapping[str, str], now: Callable[[], int] = time.time_ns
    ) -> None:
        """Begin the bag `path` with a "start" event, whose reason is the kind, and notes.

        `now` is the clock of the times of reception [ns].

        Raises:
            FileExistsError: The bag exists, finished or not.
            OSError: The folder cannot be written.
        """
        self.path = path
        self.error: OSError | None = None  # that ended the writing
        self._now = now
        self._writer = BagWriter(path)
        self._topics: set[str] = set()
        self._queue: deque[tuple[Callable[..., None], tuple[object, ...]]] = deque()
        self._closing = threading.Event()
        self._enqueue(self._writer.event, "start", kind, now(), notes)
        self._thread = threading.Thread(target=self._run, name="writing", daemon=True)
        self._thread.start()

    def __contains__(self, topic: str) -> bool:
        """Whether a topic was added."""
        return topic in self._topics

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages written, by topic."""
        return self._writer.counts

    @property
    def waiting(self) -> int:
        """Number of queued messages."""
        return len(self._queue)

    def add(self, topic: str, msgtype: str, offered: Sequence[Qos]) -> None:
        """Add a topic, see `BagWriter.add`."""
        self._topics.add(topic)
        self._enqueue(self._writer.add, topic, msgtype, offered)

    def write(self, topic: str, cdr: bytes) -> None:
        """Queue a serialized message; its time of reception is now."""
        self._enqueue(self._writer.write, topic, self._now(), cdr)

    def close(self, reason: str, notes: Mapping[str, str]) -> None:
        """Write the queue and finish the bag, with notes.

        Raises:
            OSError: The writing failed; the bag stays unfinished.
        """
        self._enqueue(self._writer.event, "stop", reason, self._now())
        self._closing.set()
        self._thread.join()
        if self.error is not None:
            raise self.error
        try:
            self._writer.close(notes)
        except OSError:
            self._writer.abandon()
            raise

    def _enqueue(self, call: Callable[..., None], *arguments: object) -> None:
        if len(self._queue) < WAITING_MAX:
            self._queue.append((call, arguments))
        elif self.error is None:
            self.error = OSError(f"the disk is too slow: {WAITING_MAX} messages are queued")

    def _run(self) -> None:
        """Body of the thread: write the queue to the disk periodically."""
        closing = False
        try:
            while not closing and self.error is None:
                closing = self._closing.wait(WRITE_PERIOD)
                while self._queue:
                    call, arguments = self._queue.popleft()
                    call(*arguments)
                self._writer.flush()
        except Exception as error:
            self.error = error if isinstance(error, OSError) else OSError(repr(error))
        if self.error is not None:
            self._writer.abandon()
