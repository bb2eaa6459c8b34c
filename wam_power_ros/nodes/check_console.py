# SPDX-License-Identifier: Apache-2.0
"""Terminal of `check_driver`: lines typed by a person, and the table of findings."""

from __future__ import annotations

import os
import select
from collections.abc import Sequence

from rich.markup import escape
from rich.table import Table

from wam_power_ros.conformance.topic_checks import Row, Verdict

COLOURS = {
    Verdict.OK: "green",
    Verdict.WARN: "yellow",
    Verdict.FAIL: "bold red",
    Verdict.UNCHECKED: "dim",
}


class Keyboard:
    """Reads lines of standard input without blocking.

    Attributes:
        closed: True once standard input has ended.
    """

    def __init__(self) -> None:
        self._text = b""
        self.closed = False

    def line(self) -> str | None:
        """Return the next line, None when none has been typed."""
        if b"\n" not in self._text and not self.closed and select.select([0], [], [], 0.0)[0]:
            read = os.read(0, 4096)
            self.closed = not read
            self._text += read
        if b"\n" not in self._text:
            return None
        line, _, self._text = self._text.partition(b"\n")
        return line.decode(errors="replace").strip()


def table(rows: Sequence[Row]) -> Table:
    """Table of the findings; those that are not OK come with the requirement, some with advice."""
    table = Table("", "", "found")
    for row in rows:
        verdict, lines = row.verdict, [escape(row.found)]
        if verdict is not Verdict.OK:
            lines.append(f"[dim]expected: {escape(row.expected)}[/dim]")
        if row.advice:
            lines.append(f"[italic]{escape(row.advice)}[/italic]")
        mark = f"[{COLOURS[verdict]}]{verdict.value}[/{COLOURS[verdict]}]"
        table.add_row(row.name, mark, "\n".join(lines))
    return table
