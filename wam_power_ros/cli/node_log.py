# SPDX-License-Identifier: Apache-2.0
"""New entries in the logs of the nodes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

LOG_LINE = re.compile(r"\[(DEBUG|INFO|WARN|ERROR|FATAL)\] \[[\d.]+\] \[([^\]]+)\]: (.*)")
PROBLEMS = ("WARN", "ERROR", "FATAL")  # severities shown as problems


class LogEntry(NamedTuple):
    """An entry of a node's log."""

    severity: str  # one of DEBUG, INFO, WARN, ERROR, FATAL
    text: str  # name of the node and message


class NodeLogs:
    """Reads what is appended to the logs of a folder from now on."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read = {file: file.stat().st_size for file in folder.glob("*.log")}

    def new(self) -> Iterator[LogEntry]:
        """Entries written since the last call, file by file; skips lines of other formats."""
        for file in sorted(self._folder.glob("*.log")):
            with file.open("rb") as opened:
                opened.seek(self._read.get(file, 0))
                text, newline, _ = opened.read().rpartition(b"\n")
            self._read[file] = self._read.get(file, 0) + len(text) + len(newline)
            for line in text.decode(errors="replace").splitlines():
                if found := LOG_LINE.match(line):
                    yield LogEntry(found[1], f"{found[2]}: {found[3]}")
