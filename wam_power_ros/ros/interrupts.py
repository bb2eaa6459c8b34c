# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM as one KeyboardInterrupt.

Only for processes whose main thread dispatches no callbacks: an exception that a signal handler
raises while the events executor calls Python from C++ becomes a RuntimeError or is lost.
"""

from __future__ import annotations

import signal
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def install() -> None:
    """Let the first signal interrupt the process as Ctrl-C does; further ones are ignored."""
    for number in SIGNALS:
        signal.signal(number, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    for each in SIGNALS:
        signal.signal(each, signal.SIG_IGN)
    raise KeyboardInterrupt
