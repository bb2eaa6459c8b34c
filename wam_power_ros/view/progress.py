# SPDX-License-Identifier: Apache-2.0
"""Progress of a session: learning curve and return terms, updated as the log grows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import numpy as np

from wam_power_ros.practice import session
from wam_power_ros.practice.failure import why_failed
from wam_power_ros.practice.session_log import KIND_NAMES, Kind, Record
from wam_power_ros.reporting.terminal import failed, number, returned, term_names
from wam_power_ros.tasks.task import Task
from wam_power_ros.view.page import Page, plain

KINDS: tuple[str, ...] = get_args(Kind)
NEWEST_COUNT = 4  # rollouts in the text


def curve(records: Sequence[Record]) -> tuple[np.ndarray, ...]:
    """Rollout numbers, measured returns of each kind (NaN for other rollouts), best so far."""
    numbers = np.array([float(record.number) for record in records])
    returns = np.array([np.nan if rec.ret is None else rec.ret for rec in records])
    kinds = np.array([record.kind for record in records])
    best = np.fmax.accumulate(returns) if len(returns) else returns
    return (numbers, *(np.where(kinds == kind, returns, np.nan) for kind in KINDS), best)


def newest(records: Sequence[Record], task: Task) -> str:
    """The newest rollouts as Markdown, newest first: outcomes, then the terms of their returns."""
    shown = records[: -NEWEST_COUNT - 1 : -1]
    lines = [f"**{plain(label(record))}** {plain(task.outcome(record))}  " for record in shown]
    rows = [["", *(str(record.number) for record in shown)], ["---"] * (len(shown) + 1)]
    for term in term_names(records):
        rows.append([plain(term), *(number(record.terms.get(term)) for record in shown)])
    return "\n".join([*lines, "", *(f"| {' | '.join(row)} |" for row in rows)])


def label(record: Record) -> str:
    """Label of a rollout: number, kind and return with its ratings."""
    return f"{record.number} {KIND_NAMES[record.kind]} {returned(record)}"


class Progress:
    """Shows a session and reads its log again whenever it has grown.

    Attributes:
        failed: Why the session has failed, as of `terminal.failed`.
    """

    def __init__(self, page: Page, folder: Path, task: Task) -> None:
        self._page, self._folder, self._task = page, folder, task
        self._size = -1
        self._chart = page.add_curve(KINDS)
        self.records: tuple[Record, ...] = ()
        self.failed: list[str] = []

    def refresh(self) -> None:
        """Show new rollouts.

        Raises:
            ValueError: The log cannot be read.
        """
        log = self._folder / session.LOG
        size = log.stat().st_size if log.exists() else 0
        if size == self._size:
            return
        self._size = size
        found = session.read(self._folder)
        self.records, settings = found.records, found.header.settings
        self.failed = failed(why_failed(self.records, self._task, settings, found.start))
        self._chart.data = curve(self.records)
        self._page.terms.content = newest(self.records, self._task)
