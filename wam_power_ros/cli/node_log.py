# SPDX-License-Identifier: Apache-2.0
"""New lines in the logs of the nodes, and signs of life while something takes long."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from wam_power_ros.console.prompt import show

QUIET_MAX = 5.0  # [s] without a word on the terminal
LINE = re.compile(r"\[(DEBUG|INFO|WARN|ERROR|FATAL)\] \[[\d.]+\] \[([^\]]+)\]: (.*)")
TROUBLE = ("WARN", "ERROR", "FATAL")


@dataclass(frozen=True)
class Said:
    """A line of a node's log.

    Attributes:
        severity: One of INFO, WARN, ERROR, FATAL.
        text: Node and message.
    """

    severity: str
    text: str


class NodeLogs:
    """Reads the logs of a folder as they grow, from their present end on."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read = {file: file.stat().st_size for file in folder.glob("*.log")}

    def new(self) -> Iterator[Said]:
        """Complete lines written since the last call, file by file; others than log lines not."""
        for file in sorted(self._folder.glob("*.log")):
            with file.open("rb") as opened:
                opened.seek(self._read.get(file, 0))
                text, newline, _ = opened.read().rpartition(b"\n")
            self._read[file] = self._read.get(file, 0) + len(text) + len(newline)
            for line in text.decode(errors="replace").splitlines():
                if found := LINE.match(line):
                    yield Said(found[1], f"{found[2]}: {found[3]}")


@contextmanager
def telling(what: str) -> Iterator[None]:
    """Say now and then that something goes on that takes long."""
    over, begun = threading.Event(), time.monotonic()

    def tell() -> None:
        while not over.wait(QUIET_MAX):
            show(f"{what}, {time.monotonic() - begun:.0f} s")

    thread = threading.Thread(target=tell, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
