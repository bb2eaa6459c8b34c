# SPDX-License-Identifier: Apache-2.0
"""Progress of a session: columns of the learning curve, and the terms of the newest returns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

import numpy as np

from wam_power_ros.practice.session_log import KIND_NAMES, Kind, Record
from wam_power_ros.reporting.terminal import number, returned, term_names
from wam_power_ros.tasks.task import Task
from wam_power_ros.view.page import plain

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
