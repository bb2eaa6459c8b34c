# SPDX-License-Identifier: Apache-2.0
"""Keys of the terminal during a session: r, p and space do what `wam-power feedback` does."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import termios
import tty
from collections.abc import Mapping
from contextlib import suppress

HINT = "keys: r reward, p punish, space pause or continue"


class Keys:
    """Context manager that passes keys to the learner; does nothing without a terminal.

    A process of its own calls the services: this one stays without ROS.

    Args:
        environment: Variables of that process, such as the session's ROS_DOMAIN_ID.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = {**os.environ, **environment}
        self._terminal: int | None = None
        self._paused = False
        self._said = ""

    def __enter__(self) -> Keys:
        fd = sys.stdin.fileno() if sys.stdin.isatty() else None
        if fd is not None and os.tcgetpgrp(fd) == os.getpgrp():  # else it is not ours to set
            self._before = termios.tcgetattr(fd)
            command = [sys.executable, "-m", "wam_power_ros.console.feedback"]
            self._caller = subprocess.Popen(
                command,
                env=self._environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            tty.setcbreak(fd)
            self._terminal, self._said = fd, HINT
        return self

    def __exit__(self, *error: object) -> None:
        if self._terminal is not None:
            termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)
            with suppress(OSError):
                self._caller.stdin.close()  # by which it ends
            self._caller.stdout.close()

    def poll(self) -> str:
        """Pass on the keys that have been pressed; returns what was answered last."""
        if self._terminal is None:
            return ""
        if _readable(self._terminal):
            for key in os.read(self._terminal, 64).decode(errors="replace"):
                self._press(key)
        if _readable(self._caller.stdout.fileno()):
            answers = os.read(self._caller.stdout.fileno(), 4096).decode(errors="replace")
            self._said = (answers.strip().splitlines() or ["no learner is there"])[-1]
        return self._said

    def _press(self, key: str) -> None:
        pause = "continue" if self._paused else "pause"
        kind = {"r": "reward", "p": "punish", " ": pause}.get(key)
        if kind is None:
            return
        if key == " ":
            self._paused = not self._paused
        try:
            self._caller.stdin.write(f"{kind}\n".encode())
            self._caller.stdin.flush()
            self._said = f"{kind} …"
        except OSError:
            self._said = "keys have ended; wam-power feedback does the same"


def _readable(fd: int) -> bool:
    return bool(select.select([fd], [], [], 0.0)[0])
