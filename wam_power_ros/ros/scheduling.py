# SPDX-License-Identifier: Apache-2.0
"""Real-time scheduling where the machine allows it: SCHED_FIFO, locked memory, frozen heap."""

from __future__ import annotations

import ctypes
import gc
import os
from dataclasses import dataclass
from pathlib import Path

MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4


@dataclass(frozen=True)
class Granted:
    """Outcome of a request; each text is "granted" or the reason why not."""

    scheduling: str = "not requested"  # real-time scheduling
    memory: str = "not requested"  # locked memory

    @property
    def complete(self) -> bool:
        """True if both were granted."""
        return self.scheduling == self.memory == "granted"


def request(priority: int) -> Granted:
    """Request SCHED_FIFO in every thread of the process, locked memory and a frozen heap.

    The priority is 1 to 99; 0 requests nothing. A refusal raises nothing, it is returned.
    """
    if priority == 0:
        return Granted()
    gc.collect()
    gc.freeze()  # the collector never scans the objects made at the start again
    return Granted(_schedule(priority), _lock_memory())


def _schedule(priority: int) -> str:
    try:  # threads made later inherit from the one that makes them
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, ValueError) as error:
        return f"refused: {error}; allow rtprio in /etc/security/limits.d"
    return "granted"


def _lock_memory() -> str:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) != 0:
        reason = os.strerror(ctypes.get_errno())
        return f"refused: {reason}; allow memlock in /etc/security/limits.d"
    return "granted"
