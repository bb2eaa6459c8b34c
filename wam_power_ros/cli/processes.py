# SPDX-License-Identifier: Apache-2.0
"""The nodes of one session as processes: started, watched, always ended.

Each gets a process group of its own, so Ctrl-C in the terminal reaches the parent only, which ends
them in order. Should the parent be killed, the kernel sends them SIGINT.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

PR_SET_PDEATHSIG = 1
TAIL = 15  # lines of a log shown when a process dies


class ProcessError(RuntimeError):
    """A process ended that should not have; the message holds the end of its log."""


@dataclass(frozen=True)
class Running:
    """A started process and where its output goes."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    @property
    def tail(self) -> str:
        """Last lines of the log."""
        lines = self.log.read_text(errors="replace").splitlines()
        return "\n".join(lines[-TAIL:]) or "(nothing was printed)"


class Processes:
    """Context manager of node processes; leaving it ends them all, last started first."""

    def __init__(self, logs: Path, environment: Mapping[str, str]) -> None:
        """Logs go to `logs`/<name>.log, appended; `environment` is added to this process's own."""
        self._logs = logs
        self._environment = {**os.environ, "PYTHONUNBUFFERED": "1", **environment}
        self._running: list[Running] = []

    def start(self, name: str, command: Sequence[str], talks: bool = False) -> Running:
        """Start a command whose output goes to its log, or one that `talks` with the terminal."""
        self._logs.mkdir(parents=True, exist_ok=True)
        log = self._logs / f"{name}.log"
        with log.open("ab") as output:
            process = subprocess.Popen(
                command,
                env=self._environment,
                stdin=None if talks else subprocess.DEVNULL,
                stdout=None if talks else output,
                stderr=None if talks else output,
                start_new_session=not talks,
                preexec_fn=_end_with_parent if sys.platform == "linux" else None,
            )
        self._running.append(Running(name, process, log))
        return self._running[-1]

    def finish(self, running: Running) -> None:
        """Wait for a process that is to end by itself, while the others go on.

        Raises:
            ProcessError: It failed, or one of the others ended.
        """
        while running.process.poll() is None:
            self.check(but=running)
            time.sleep(0.05)
        self.check(but=running)
        self._running.remove(running)

    def wait(self, running: Running) -> int:
        """Exit status of a process that is to end by itself and speaks of its own failures.

        Raises:
            ProcessError: One of the others ended.
        """
        while (status := running.process.poll()) is None:
            self._check(other for other in self._running if other is not running)
            time.sleep(0.05)
        self._running.remove(running)
        return status

    def check(self, but: Running | None = None) -> None:
        """Raise when a process has ended, whatever its exit status.

        Args:
            but: The one that may end with status 0.

        Raises:
            ProcessError: With the name, the exit status and the end of the log.
        """
        well = but is not None and but.process.poll() == 0
        self._check(other for other in self._running if not (well and other is but))

    def _check(self, those: Iterable[Running]) -> None:
        for running in those:
            status = running.process.poll()
            if status is None:
                continue
            how = f"signal {-status}" if status < 0 else f"status {status}"
            raise ProcessError(
                f"{running.name} ended with {how}. End of {running.log}:\n{running.tail}"
            )

    def stop(self, patience: float = 8.0) -> None:
        """End every process: SIGINT, after `patience` [s] SIGTERM, then SIGKILL."""
        while self._running:
            process = self._running.pop().process
            for how in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
                if process.poll() is not None:
                    break
                process.send_signal(how)
                try:
                    process.wait(patience)
                except subprocess.TimeoutExpired:
                    continue

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()


def _end_with_parent() -> None:
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGINT)
