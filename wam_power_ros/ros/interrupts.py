# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM as KeyboardInterrupt, but never from within the middleware.

An exception that a signal handler raises while the events executor calls Python from C++ becomes a
RuntimeError or is lost. So it is raised only after the executor has returned.
"""

from __future__ import annotations

import signal
from types import FrameType

from rclpy.executors import Executor

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class _Process:
    """State of the process; its signal handlers are global, too."""

    dispatching = False
    interrupted = False


def install() -> None:
    """Let the first signal interrupt the process as Ctrl-C does; further ones are ignored."""
    _Process.dispatching = _Process.interrupted = False
    for number in SIGNALS:
        signal.signal(number, _interrupt)


def spin_once(executor: Executor, timeout: float) -> None:
    """Dispatch at most one callback.

    Args:
        executor: Executor of the node.
        timeout: Longest wait for it [s].

    Raises:
        KeyboardInterrupt: A signal came meanwhile. Raised once, so that the clean-up may dispatch
            again.
    """
    _Process.dispatching = True
    try:
        executor.spin_once(timeout_sec=timeout)
    finally:
        _Process.dispatching = False
        if _Process.interrupted:
            _Process.interrupted = False
            raise KeyboardInterrupt


def _interrupt(number: int, frame: FrameType | None) -> None:
    for each in SIGNALS:
        signal.signal(each, signal.SIG_IGN)
    if not _Process.dispatching:
        raise KeyboardInterrupt
    _Process.interrupted = True
