# SPDX-License-Identifier: Apache-2.0
"""Keys of the terminal during a session, which act as `wam-power feedback` and `stop` do."""

from __future__ import annotations

import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

KEYS = {"r": "reward", "p": "punish", "s": "stop", " ": "pause", "c": "continue"}
HINT = "keys: s stop the arm, space pause, c continue, r reward, p punish, 0 to 9 rate if asked"


@contextmanager
def passing_keys(domain: int | None) -> Iterator[Callable[[], str]]:
    """Pass keys on to the learner in the block; nothing without a terminal.

    `domain` is the DDS domain of a simulation; None for that of ROS_DOMAIN_ID. The function that is
    yielded passes on the keys that were pressed and returns the status to display.
    """
    fd = sys.stdin.fileno() if sys.stdin.isatty() else None
    if fd is None or os.tcgetpgrp(fd) != os.getpgrp():  # a background job
        yield lambda: ""
        return
    from wam_power_ros.client.feedback import answered, connected

    status = HINT

    def give(key: str) -> None:  # in a thread of its own: a stop waits for no other answer
        nonlocal status
        kind, value = (KEYS[key], None) if key in KEYS else ("rate", int(key) / 9.0)
        status = f"{kind} …"
        answer = answered(lambda: feedback.give(kind, value=value))
        status = answer.text if answer.success else f"{kind} refused: {answer.text}"

    def poll() -> str:
        if select.select([fd], [], [], 0.0)[0]:
            for key in os.read(fd, 64).decode(errors="replace"):
                if key in KEYS or key in "0123456789":
                    threading.Thread(target=give, args=(key,), daemon=True).start()
        return status

    with connected(domain, quiet=True) as feedback:
        before = termios.tcgetattr(fd)
        try:
            tty.setcbreak(fd)
            yield poll
        finally:
            termios.tcsetattr(fd, termios.TCSADRAIN, before)
