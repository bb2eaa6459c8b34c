# SPDX-License-Identifier: Apache-2.0
"""Table of the findings of `check_driver` in the terminal."""

from __future__ import annotations

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
