# SPDX-License-Identifier: Apache-2.0
"""Display of a running session: a live table on a terminal, one line per rollout in a file."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Callable, Sequence

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from wam_power_ros.practice.best_policy import reproduction_learnt_from
from wam_power_ros.practice.failure import Cause, Failure
from wam_power_ros.practice.session_log import KIND_NAMES, Line, Record, with_ratings
from wam_power_ros.practice.settings import SessionSettings
from wam_power_ros.tasks.task import Task

ROLLOUTS_SHOWN = 14  # newest rollouts in the table
OUTCOME_MIN = 24  # width of the column [characters]
STYLES = {"reproduction": "cyan", "explore": "", "mean": "magenta", "retest": "green"}
BY = {"none": "by nobody", "arm": "by the arm", "person": "by a person"}
FAILED = {  # count, total, detail and size are those of `Failure`
    Cause.CLOCKS: "the cameras' stamps were {ms:+.0f} ms late in {of}: synchronise the clocks, or "
    "set latency_offset",
    Cause.UNSEEN: "{of} could not be judged, the last one because {detail}",
    Cause.PLANE: "the keep-out plane ended {of}: demonstrate farther from it, or correct it",
    Cause.LIMITS: "a limit of the arm, {detail}, ended {of}: demonstrate a slower movement, or one "
    "farther inside the limits",
    Cause.TORQUE: "torques that no command explains ended {of}: the tool has another mass than in "
    "the URDF, which wam-power commission measures, or something touches the arm",
    Cause.FAULTS: "faults that no policy causes, most often {detail}, ended {of}: "
    "docs/troubleshooting.md has their causes",
    Cause.SOFT: "the springs of the policy are too soft: the movement follows a shift of its last "
    "attractors by only {size:.0%}; fit the demonstration with more stiffness",
    Cause.UNMEASURED: "{detail} had no value in {of}, so nothing told what to change: demonstrate "
    "a movement that gets as far",
    Cause.DRIFT: "{detail} changed by {size:+.1f} tolerances over the session, whatever was tried: "
    "something drifts, such as a tool that comes loose or a body that wears",
    Cause.IGNORED: "{detail} followed the learnt parameters by {share} of what the task's model "
    "expects: the cameras' frame is turned or mirrored, or the model is not of this robot",
    Cause.DISAGREE: "the return disagrees with success: a success had the higher return in only "
    "{size:.0%} of the comparisons with other rollouts; learn from another return",
    Cause.FELL_BACK: "PoWER chose {of}, because no plan on the measured errors was better than "
    "what had been run: the errors leave out something that matters, or the model is wrong",
    Cause.UNKNOWN: "{total} rollouts show none of the known causes: practise longer, or learn from "
    "another demonstration",
}
Outcome = Callable[[Record], str]  # such as `Task.outcome`


def number(value: float | None) -> str:
    """Format a return or one of its terms; a dash for None."""
    return "–" if value is None else f"{value:.3f}"


def returned(record: Record) -> str:
    """Return of a rollout and the sum of its ratings, such as "0.712 +0.3"."""
    rating = f" {record.adjustment:+.3g}" if record.adjustment is not None else ""
    return number(record.ret) + rating


def term_names(records: Sequence[Record]) -> list[str]:
    """Names of all terms of the returns, in order of appearance."""
    return list(dict.fromkeys(name for record in records for name in record.terms))


def rollout_table(records: Sequence[Record], outcome: Outcome, width: int = 160) -> Table:
    """Newest rollouts: return, its terms, those that `width` has no room for by name, outcome."""
    newest, bests, best = records[-ROLLOUTS_SHOWN:], [], 0.0
    for record in records:
        better = record.ret is not None and record.ret > best
        best = max(best, record.ret or 0.0)  # as measured: ratings are shown beside the returns
        bests.append((best, better))
    terms = term_names(records)
    longest = max((len(outcome(record)) for record in newest), default=0)
    room = width - 36 - min(longest, OUTCOME_MIN)  # 36 for number, kind, return and best
    while terms and sum(max(len(term), 5) + 1 for term in terms) > room:
        terms.pop()
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 1, 0, 0))
    if hidden := term_names(records)[len(terms) :]:
        table.caption, table.caption_justify = f"no room for {', '.join(hidden)}", "left"
    table.add_column("#", justify="right", no_wrap=True)
    table.add_column("kind", no_wrap=True)
    for name in ["return", *terms, "best"]:
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("outcome", no_wrap=True, overflow="ellipsis")
    for record, (top, better) in zip(newest, bests[-ROLLOUTS_SHOWN:], strict=True):
        table.add_row(
            str(record.number),
            Text(KIND_NAMES[record.kind], style=STYLES.get(record.kind, "")),
            Text(returned(record), style="bold green" if better else ""),
            *(number(record.terms.get(term)) for term in terms),
            f"{top:.3f}",
            Text(outcome(record), style="green" if record.success else ""),
        )
    return table


def summary(records: Sequence[Record], task: Task) -> str:
    """Summary of a session in a few lines: rollouts, returns, outcomes, last decision."""
    returns = [record.ret for record in records if record.ret is not None]
    if not returns:
        return f"{counted(len(records), 'rollout')}, none usable"
    best, last = max(records, key=lambda record: record.ret or 0.0), returns[-5:]
    retests = [record for record in records if record.kind == "retest"]
    lines = [
        f"{counted(len(records), 'rollout')}; mean return {sum(last) / len(last):.3f} of the last "
        f"{len(last)}, best {best.ret:.3f} in rollout {best.number} ({task.outcome(best)})",
        *before_and_after(records, task),
        *task.summary(records),
        *resets(records),
        *(f"  {label} {value}" for label, value in task.measured(retests).items()),
    ]
    if notes := [record.note for record in records if record.note]:
        lines.append(f"last decision: {notes[-1]}")
    return "\n".join(lines)


def resets(records: Sequence[Record]) -> list[str]:
    """Who put the body back before the rollouts; empty if the stand-in always did."""
    known = [record.clock["reset"] for record in records if record.clock.get("reset")]
    if not known:
        return []
    seconds = {by: [each["seconds"] for each in known if each["by"] == by] for by in BY}
    text = ", ".join(
        f"{who} in {len(seconds[by])} (median {np.median(seconds[by]):.0f} s)"
        for by, who in BY.items()
        if seconds[by]
    )
    return [f"put back before {counted(len(known), 'rollout')}: {text}"]


def counted(number: int, noun: str) -> str:
    """Number and noun, with a plural s unless the number is one."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def wrapped(text: str) -> str:
    """Wrap lines between words to the width of the terminal; unchanged if the output is a file."""
    width = shutil.get_terminal_size((10_000, 0)).columns
    lines = text.splitlines()
    return "\n".join(textwrap.fill(line, width, subsequent_indent="    ") for line in lines)


def before_and_after(records: Sequence[Record], task: Task) -> list[str]:
    """Reproduction and, if any, re-tests; empty before a demonstration is chosen."""
    first = reproduction_learnt_from(records)
    if first is None:
        return []
    already = "a success already" if first.success else "no success"
    line = (
        f"before learning: return {number(first.ret)}, {already} ({task.outcome(first)}), "
        f"the reproduction of {first.demonstration}"
    )
    tests = [record for record in records if record.kind == "retest"]
    if returns := [record.ret for record in tests if record.ret is not None]:
        succeeded = sum(record.success for record in tests)
        line += (
            f"; after it: mean return {np.mean(returns):.3f}, "
            f"{succeeded} of {len(tests)} re-tests succeeded"
        )
    return [line]


def failed(found: Failure | None) -> list[str]:
    """Why a session has failed, in one sentence; empty if it has not."""
    if found is None:
        return []
    text = FAILED[found.cause].format(
        of=f"{found.count} of {counted(found.total, 'rollout')}",
        total=found.total,
        detail=found.detail.replace("_", " "),
        size=found.size,
        ms=found.size * 1e3,
        share="none" if found.size <= 0.0 else f"at most {found.size:.0%}",
    )
    return [f"why it failed: {text}"]


def choice(records: Sequence[Record], id: str) -> list[str]:
    """Why the session's policy, first run by trial `id`, is not that of the highest return."""
    usable = [record for record in records if record.ret is not None]
    own = {record.executed for record in usable if record.id == id}
    runs = [r for r in usable if r.executed in own and r.kind != "explore" and not r.refused]
    if not runs:
        return []
    mean, succeeded = np.mean([run.ret for run in runs]), sum(run.success for run in runs)
    line = (
        f"the session's policy is that of {id}: mean return {mean:.3f}, {succeeded} of "
        f"{counted(len(runs), 'run')} without exploration succeeded; only such runs decide"
    )
    best = max(usable, key=lambda record: record.ret or 0.0)
    if best in runs:
        return [line]
    kind = "an exploration" if best.kind == "explore" else "one run of another policy"
    return [f"{line}; the highest return, {best.ret:.3f} in rollout {best.number}, was of {kind}"]


class Display:
    """Shows new records: a live table on a terminal, one line each in a file."""

    def __init__(self, console: Console | None = None) -> None:
        self.footer = ""  # line below the table, such as the response to a key
        self._outcome: Outcome = lambda record: ""
        self._log: Sequence[Line] = ()
        self._method = ""  # of the session, once it is shown
        self._message = ""  # latest one of a node
        self._console = console or Console()
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=30),
            TimeElapsedColumn(),
            console=self._console,
        )
        self._task = self._progress.add_task("starting", total=None)
        self._live = Live(console=self._console, get_renderable=self._render)

    def __enter__(self) -> Display:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._console.is_terminal:
            self._live.stop()

    def show(self, log: Sequence[Line], settings: SessionSettings, task: Task) -> None:
        """Show the present log of a session."""
        new = log[len(self._log) :]
        if not self._method:
            self._method = settings.described(task)
            self._print(self._method[0].upper() + self._method[1:])
        self._outcome, self._log = task.outcome, tuple(log)  # a live session's grows
        records = [entry for entry in log if isinstance(entry, Record)]
        tests = sum(record.kind == "retest" for record in records)
        count, total = len(records) - tests, settings.practice.budget
        text = f"{count} of at most {counted(total, 'rollout')}"
        if tests:
            count, total = tests, settings.practice.retests
            text = f"re-test {count} of {total}"
        self._progress.update(self._task, completed=count, total=total, description=text)
        if not self._console.is_terminal:
            for entry in new:
                self._print(line(entry, task.outcome))

    def show_message(self, text: str, is_problem: bool) -> None:
        """Show a log message of a node: a problem above the table, others below it."""
        self._message = text
        if is_problem:
            self._print(text, style="yellow")

    def _print(self, text: str, style: str = "") -> None:
        self._console.print(text, style=style, highlight=False, soft_wrap=True, markup=False)

    def _render(self) -> RenderableType:
        records = with_ratings(self._log)
        message = Text(self._message, style="dim", no_wrap=True, overflow="ellipsis")
        if not records:
            waiting = Text("waiting for the first rollout", style="italic")
            return Group(waiting, message, Text(self.footer), self._progress)
        notes = [entry.note for entry in self._log if entry.note]
        parts: list[RenderableType] = [
            rollout_table(records, self._outcome, width=self._console.width),
            Text(notes[-1] if notes else "", style="italic"),
        ]
        return Group(*parts, message, Text(self.footer), self._progress)


def line(entry: Line, outcome: Outcome) -> str:
    """One line on a rollout or on an input of a person."""
    if not isinstance(entry, Record):
        return f"      a person: {entry.note}"
    terms = ", ".join(f"{name} {number(value)}" for name, value in entry.terms.items())
    return (
        f"{entry.number:4d}  {KIND_NAMES[entry.kind]:12s}  return {number(entry.ret)} ({terms})  "
        f"{outcome(entry)}" + (f"  [{entry.note}]" if entry.note else "")
    )
