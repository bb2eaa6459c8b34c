# SPDX-License-Identifier: Apache-2.0
"""Processes of the nodes of one session: start them, watch them, always end them.

Each has its own process group, so that Ctrl-C in the terminal reaches only the parent, which ends
them in order. If the parent is killed, the kernel sends them SIGTERM, because Python may lose a
SIGINT while it starts.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

LIBC = ctypes.CDLL(None)  # loaded before a process is forked, when other threads may load, too
PR_SET_PDEATHSIG = 1
TAIL_LINES = 15  # of a log, shown when a process dies
LOG_FORM = {  # that `NodeLogs` reads, whatever the terminal has
    "RCUTILS_CONSOLE_OUTPUT_FORMAT": "[{severity}] [{time}] [{name}]: {message}",
    "RCUTILS_COLORIZED_OUTPUT": "0",
}
LOG_LINE = re.compile(r"\[(DEBUG|INFO|WARN|ERROR|FATAL)\] \[[\d.]+\] \[([^\]]+)\]: (.*)")
PROBLEMS = ("WARN", "ERROR", "FATAL")
MEMORY = " (by a person, or by the kernel for lack of memory: see `dmesg`)"
SPACE_MIN = 1e6  # free bytes of a disk, below which nothing can be logged


class ProcessError(RuntimeError):
    """A process ended that should still run, with the end of its log, or it does not answer."""


@dataclass(frozen=True)
class Running:
    """A started process and the file that its output goes to."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    def error(self) -> ProcessError:
        """Error that says how the process has ended."""
        status = self.process.returncode
        cause = f"ended with status {status}"
        if status < 0:
            cause = f"was ended by {signal.Signals(-status).name}"
            cause += MEMORY if -status == signal.SIGKILL else ""
        lines = self.log.read_text(errors="replace").splitlines()[-TAIL_LINES:]
        tail = "\n".join(lines) or "(nothing was printed)"
        text = f"{self.name} {cause}. End of {self.log}:\n{tail}"
        if shutil.disk_usage(self.log.parent).free < SPACE_MIN:  # then no log says it
            text += f"\nThe disk of {self.log.parent} is full: free some space."
        return ProcessError(text)


class Processes:
    """Context manager of node processes; leaving it ends them all, last started first."""

    def __init__(self, logs: Path, environment: Mapping[str, str]) -> None:
        """Logs go to `logs`/<name>.log, appended; `environment` is added to this process's own."""
        self._logs = logs
        self._environment = {**os.environ, "PYTHONUNBUFFERED": "1", **LOG_FORM, **environment}
        self._running: list[Running] = []

    def start(self, name: str, command: Sequence[str]) -> Running:
        """Start a command; its output goes to a log."""
        self._logs.mkdir(parents=True, exist_ok=True)
        log = self._logs / f"{name}.log"
        with log.open("ab") as output:
            process = subprocess.Popen(
                command,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
                preexec_fn=_end_with_parent if sys.platform == "linux" else None,
            )
        self._running.append(Running(name, process, log))
        return self._running[-1]

    def check(self, but: Running | None = None) -> None:
        """Check that no process has ended, whatever its exit status, except one that may end.

        Raises:
            ProcessError: One has ended; the message has its name, status and the end of its log.
        """
        for running in self._running:
            if running is not but and running.process.poll() is not None:
                raise running.error()

    @contextmanager
    def watched(self, fail: Callable[[ProcessError], object]) -> Iterator[None]:
        """Raise in the main thread once a process ends, even while it waits for a person's input.

        `fail` is called before, so that what is cleaned up waits for no answer of that process.
        """

        def check(*_: object) -> None:
            try:
                self.check()
            except ProcessError as error:
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                fail(error)
                raise

        before = signal.signal(signal.SIGCHLD, check)
        try:
            check()  # what ended before
            yield
        finally:
            signal.signal(signal.SIGCHLD, before)

    def stop(self, timeout: float = 8.0) -> None:
        """End every process: SIGINT, after `timeout` [s] SIGTERM, then SIGKILL."""
        while self._running:
            process = self._running.pop().process
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
                if process.poll() is not None:
                    break
                process.send_signal(number)
                try:
                    process.wait(timeout)
                except subprocess.TimeoutExpired:
                    continue

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()


class NodeLogs:
    """Reads what is appended to the logs of a folder from now on."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read = {file: file.stat().st_size for file in folder.glob("*.log")}

    def new(self) -> Iterator[tuple[str, bool]]:
        """Messages since the last call, with the node's name, and whether each is a problem."""
        for file in sorted(self._folder.glob("*.log")):
            with file.open("rb") as opened:
                opened.seek(self._read.get(file, 0))
                text, newline, _ = opened.read().rpartition(b"\n")
            self._read[file] = self._read.get(file, 0) + len(text) + len(newline)
            for line in text.decode(errors="replace").splitlines():
                if found := LOG_LINE.match(line):  # not of other formats
                    yield f"{found[2]}: {found[3]}", found[1] in PROBLEMS


def _end_with_parent() -> None:
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
