# SPDX-License-Identifier: Apache-2.0
"""Removal of the shared memory of killed processes.

Fast DDS keeps a segment for every participant in /dev/shm, with a lock file that its process holds,
and removes both when it ends. After a kill (-9) both stay, half a megabyte each, until the machine
is rebooted. A free lock proves that the owner is dead, as for `fastdds shm clean`.
"""

from __future__ import annotations

import fcntl
import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

FOLDER = Path("/dev/shm")
SEGMENT_LOCK = re.compile(r"fastrtps_[0-9a-f]{16}_el")


def remove_dead_segments(folder: Path = FOLDER) -> int:
    """Remove the segments whose owner is dead; returns their number."""
    removed = 0
    with suppress(OSError):
        for lock in list(folder.iterdir()):
            if SEGMENT_LOCK.fullmatch(lock.name):
                removed += _remove_if_free(lock, [lock.with_name(lock.name.removesuffix("_el"))])
    return removed


def remove_ports(numbers: Iterable[int], folder: Path = FOLDER) -> None:
    """Remove the queues of ports without a listener, in a domain without participants.

    In a domain with participants they must stay: a sender to such a queue would lose its listener.
    """
    for number in numbers:
        queue = folder / f"fastrtps_port{number}"
        if queue.exists():
            mutex = folder / f"sem.{queue.name}_mutex"
            _remove_if_free(queue.with_name(f"{queue.name}_el"), [queue, mutex])


def _remove_if_free(lock: Path, files: list[Path]) -> bool:
    """Remove files and their lock file unless a process holds it; returns True if removed."""
    try:
        with lock.open("a") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for path in (*files, lock):
                path.unlink(missing_ok=True)
    except OSError:  # held, or another user's
        return False
    return True
