# SPDX-License-Identifier: Apache-2.0
"""Keys of the terminal during a session, which act as `wam-power feedback` and `stop` do."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import termios
import tty
from collections.abc import Mapping
from contextlib import suppress

KEYS = {"r": "reward", "p": "punish", "s": "stop", " ": "pause", "c": "continue"}
KEYS |= {str(key): f"rate {key / 9.0}" for key in range(10)}
HINT = "keys: s stop the arm, space pause, c continue, r reward, p punish, 0 to 9 rate if asked"


class Keys:
    """Context manager that passes keys to the learner; does nothing without a terminal.

    A child process calls the services, so that this process need not import ROS.

    Args:
        environment: Environment variables of the child, such as the session's ROS_DOMAIN_ID.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = {**os.environ, **environment}
        self._terminal: int | None = None
        self._status = ""

    def __enter__(self) -> Keys:
        fd = sys.stdin.fileno() if sys.stdin.isatty() else None
        if fd is not None and os.tcgetpgrp(fd) == os.getpgrp():  # else a background job
            self._before = termios.tcgetattr(fd)
            command = [sys.executable, "-m", "wam_power_ros.console.feedback"]
            self._feedback = subprocess.Popen(
                command,
                env=self._environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            tty.setcbreak(fd)
            self._terminal, self._status = fd, HINT
        return self

    def __exit__(self, *error: object) -> None:
        if self._terminal is not None:
            termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)
            with suppress(OSError):
                self._feedback.stdin.close()  # which ends the process
            self._feedback.stdout.close()

    def poll(self) -> str:
        """Pass on the keys that were pressed; return the status to display."""
        if self._terminal is None:
            return ""
        if _readable(self._terminal):
            for key in os.read(self._terminal, 64).decode(errors="replace"):
                self._press(key)
        if _readable(self._feedback.stdout.fileno()):
            answers = os.read(self._feedback.stdout.fileno(), 4096).decode(errors="replace")
            self._status = (answers.strip().splitlines() or ["no learner answers"])[-1]
        return self._status

    def _press(self, key: str) -> None:
        if (kind := KEYS.get(key)) is None:
            return
        try:
            self._feedback.stdin.write(f"{kind}\n".encode())
            self._feedback.stdin.flush()
            self._status = f"{kind} …"
        except OSError:
            self._status = "keys are disabled; use wam-power feedback"


def _readable(fd: int) -> bool:
    return bool(select.select([fd], [], [], 0.0)[0])
