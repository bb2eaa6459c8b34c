# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM as KeyboardInterrupt, but never from within the middleware.

An exception that a signal handler raises while the events executor calls Python from C++ comes out
of it as a RuntimeError, or not at all. So the middleware is left first.
"""

from __future__ import annotations

import signal
from types import FrameType

from rclpy.executors import Executor

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class _Process:
    """What belongs to the process, as its signal handlers do."""

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
        KeyboardInterrupt: A signal came meanwhile. It is raised once: what is cleaned up after it
            may dispatch again.
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
