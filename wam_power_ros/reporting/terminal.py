# SPDX-License-Identifier: Apache-2.0
"""What a session shows while it runs: its rollouts as a table that grows, line by line in a log."""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from wam_power_ros.practice.session_log import Line, Record, with_ratings
from wam_power_ros.tasks.flip.flight import Flight
from wam_power_ros.tasks.flip.returns import pancake_return

SHOWN = 14  # newest rollouts in the table
BARS = "▁▂▃▄▅▆▇█"
STYLES = {"reproduction": "cyan", "explore": "", "mean": "magenta", "retest": "green"}


def outcome(record: Record) -> str:
    """What became of the pancake, by the tracker's view, in words."""
    if record.fault:
        return f"fault: {record.fault}"
    flight = record.observation
    if flight is None:
        return record.why or "not seen"
    caught = "caught" if flight.get("resting") else "dropped"
    if not flight.get("tossed"):
        return "not tossed" if flight.get("resting") else "not tossed, dropped"
    return f"flipped, {caught}" if flight.get("flipped") else caught


def angle(record: Record) -> float | None:
    """How far the pancake had turned at t_f [degree], None when that is not known."""
    turned = (record.observation or {}).get("angle")
    return None if turned is None else abs(math.degrees(turned))


def returned(record: Record) -> str:
    """Its return, with what a person added or took: "0.712 +0.3"."""
    rating = f" {record.adjustment:+.3g}" if record.adjustment is not None else ""
    return _number(record.ret, ".3f") + rating


def paper_return(record: Record) -> float:
    """Eq. 5 of a rollout, whatever the session learnt from; NaN when no pancake was seen."""
    seen = set(record.observation or ()) == {field.name for field in dataclasses.fields(Flight)}
    if record.ret is None or record.observation is None or not seen:
        return math.nan
    fields = {
        name: np.array(value) if isinstance(value, list) else value
        for name, value in record.observation.items()
    }
    return pancake_return(Flight(**fields)).total


def spark(values: Sequence[float], width: int = 60) -> str:
    """The last `width` values as a row of bars from 0 to the largest."""
    top = max(values, default=0.0)
    shown = values[-width:]
    return "".join(BARS[round((len(BARS) - 1) * v / top)] if top > 0 else BARS[0] for v in shown)


def rollout_table(records: Sequence[Record], shown: int = SHOWN) -> Table:
    """The newest rollouts: return and its terms, angle, outcome, best so far."""
    terms = list(dict.fromkeys(term for record in records for term in record.terms))
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("rollout", justify="right")
    table.add_column("kind")
    for name in ["return", *terms, "angle", "best"]:
        table.add_column(name, justify="right")
    table.add_column("pancake", no_wrap=True)
    best = 0.0
    for place, record in enumerate(records):
        better = record.rated_return is not None and record.rated_return > best
        best = max(best, record.rated_return or 0.0)
        if place < len(records) - shown:
            continue
        turned = angle(record)
        table.add_row(
            str(record.number),
            Text(record.kind, style=STYLES.get(record.kind, "")),
            Text(returned(record), style="bold green" if better else ""),
            *(_number(record.terms.get(term), ".3f") for term in terms),
            _number(turned, ".0f", "°"),
            f"{best:.3f}",
            Text(outcome(record), style="green" if record.success else ""),
        )
    return table


def summary(records: Sequence[Record]) -> str:
    """A session in a few lines: rollouts, returns, successes, what was decided last."""
    returns = [record.ret for record in records if record.ret is not None]
    if not returns:
        return f"{len(records)} rollouts, none of them usable"
    best = max(records, key=lambda record: record.ret or 0.0)
    lines = [
        f"{len(records)} rollouts; return {returns[0]:.3f} at first, "
        f"{sum(returns[-5:]) / len(returns[-5:]):.3f} over the last {len(returns[-5:])}, "
        f"best {best.ret:.3f} in rollout {best.number} ({outcome(best)})"
    ]
    retests = [record for record in records if record.kind == "retest"]
    if retests:
        caught = sum(outcome(record) == "flipped, caught" for record in retests)
        paper = [r for r in map(paper_return, retests) if math.isfinite(r)]
        lines.append(
            f"re-tests of the answer: {caught} of {len(retests)} flipped and caught; "
            + (f"Eq. 5 {statistics.mean(paper):.3f}, at least {min(paper):.3f}" if paper else "")
        )
        known = [record.truth for record in retests if record.truth]
        if known:
            lines += _verdict(known)
    stopped = [record.note for record in records if record.note]
    if stopped:
        lines.append(f"last decision: {stopped[-1]}")
    return "\n".join(lines)


def _verdict(truths: Sequence[Mapping[str, Any]]) -> list[str]:
    """What the simulator knows of some rollouts, in lines."""
    flipped = sum(bool(t.get("caught") and t.get("flipped")) for t in truths)
    true = sum(bool(t.get("true_flip")) for t in truths)
    lines = [
        f"  the simulator's own verdict: {flipped} of {len(truths)} flipped and caught, "
        f"{true} by a true flip (150 to 240 degrees in the air)"
    ]
    if all("peak_qd" in truth for truth in truths):
        qd = np.max([truth["peak_qd"] for truth in truths], axis=0)
        elbow, forearm, pan = (
            max(truth[f"peak_{point}_speed"] for truth in truths)
            for point in ("elbow", "forearm", "pan")
        )
        beyond = sum(bool(truth["beyond_no_load"]) for truth in truths)
        lines += [
            f"  peak joint speeds {' '.join(f'{v:.1f}' for v in qd)} rad/s; beyond a motor's "
            f"no-load speed in {beyond} of {len(truths)}",
            f"  peak speeds of elbow {elbow:.2f}, point 350 mm beyond it {forearm:.2f}, "
            f"pan {pan:.2f} m/s",
        ]
    return lines


class Display:
    """Shows records as they come: a live table on a terminal, one line each in a file."""

    def __init__(self, console: Console | None = None) -> None:
        self._log: Sequence[Line] = ()
        self._console = console or Console()
        self._progress = Progress(
            TextColumn("{task.completed:.0f} of at most {task.total:.0f} rollouts"),
            BarColumn(bar_width=40),
            TimeElapsedColumn(),
            console=self._console,
        )
        self._task = self._progress.add_task("")
        self._live = Live(console=self._console, get_renderable=self._render)

    def __enter__(self) -> Display:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._console.is_terminal:
            self._live.stop()

    def show(self, log: Sequence[Line], most: int) -> None:
        """Show the session as it stands.

        Args:
            log: All of it; what was not shown before is printed where there is no terminal.
            most: So many rollouts there can be.
        """
        new = log[len(self._log) :]
        self._log = log
        count = sum(isinstance(entry, Record) for entry in log)
        self._progress.update(self._task, completed=count, total=max(most, count))
        if not self._console.is_terminal:
            for entry in new:
                self._console.print(line(entry), highlight=False, soft_wrap=True, markup=False)

    def _render(self) -> RenderableType:
        records = with_ratings(self._log)
        if not records:
            return Group(Text("the first rollout is on its way", style="italic"), self._progress)
        returns = [record.rated_return for record in records if record.rated_return is not None]
        notes = [entry.note for entry in self._log if entry.note]
        parts = [rollout_table(records), Text(spark(returns), style="green")]
        return Group(*parts, Text(notes[-1] if notes else "", style="italic"), self._progress)


def line(entry: Line) -> str:
    """A rollout, or what a person did, in one line."""
    if not isinstance(entry, Record):
        return f"      a person: {entry.note}"
    terms = ", ".join(f"{name} {_number(value, '.3f')}" for name, value in entry.terms.items())
    return (
        f"{entry.number:4d}  {entry.kind:12s}  return {_number(entry.ret, '.3f')} ({terms})  "
        f"{_number(angle(entry), '.0f', '°'):>4s}  {outcome(entry)}"
        + (f"  [{entry.note}]" if entry.note else "")
    )


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "–" if value is None else f"{value:{form}}{unit}"
