# SPDX-License-Identifier: Apache-2.0
"""Keys of the terminal during a session, which act as `wam-power feedback` and `stop` do."""

from __future__ import annotations

import os
import select
import sys
import termios
import threading
import tty
from contextlib import ExitStack
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wam_power_ros.client.feedback import Feedback

KEYS = {"r": "reward", "p": "punish", "s": "stop", " ": "pause", "c": "continue"}
HINT = "keys: s stop the arm, space pause, c continue, r reward, p punish, 0 to 9 rate if asked"


class Keys:
    """Context manager that passes keys to the learner; does nothing without a terminal."""

    def __init__(self, domain: int | None) -> None:
        """Take the DDS domain of a simulation; None for that of ROS_DOMAIN_ID."""
        self._domain, self._ends = domain, ExitStack()
        self._feedback: Feedback | None = None
        self._status = ""

    def __enter__(self) -> Keys:
        fd = sys.stdin.fileno() if sys.stdin.isatty() else None
        if fd is not None and os.tcgetpgrp(fd) == os.getpgrp():  # else a background job
            from wam_power_ros.client.feedback import connected

            with self._ends as ends:
                self._feedback = ends.enter_context(connected(self._domain, quiet=True))
                ends.callback(termios.tcsetattr, fd, termios.TCSADRAIN, termios.tcgetattr(fd))
                tty.setcbreak(fd)
                self._status, self._ends = HINT, ends.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._ends.close()

    def poll(self) -> str:
        """Pass on the keys that were pressed; return the status to display."""
        if self._feedback is not None and select.select([sys.stdin], [], [], 0.0)[0]:
            for key in os.read(sys.stdin.fileno(), 64).decode(errors="replace"):
                if key in KEYS or key in "0123456789":
                    threading.Thread(target=self._give, args=(key,), daemon=True).start()
        return self._status

    def _give(self, key: str) -> None:
        """Pass on a key in a thread of its own: a stop waits for no other answer."""
        from wam_power_ros.client.feedback import answered

        kind, value = (KEYS[key], None) if key in KEYS else ("rate", int(key) / 9.0)
        self._status = f"{kind} …"
        answer = answered(lambda: self._feedback.give(kind, value=value))
        self._status = answer.text if answer.success else f"{kind} refused: {answer.text}"
