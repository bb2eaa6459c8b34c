# SPDX-License-Identifier: Apache-2.0
"""`wam-power sessions`: list sessions by a line each, or compare some side by side."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wam_power_ros import installed
from wam_power_ros.cli.launcher import UsageError, short_path
from wam_power_ros.cli.parser import add_command
from wam_power_ros.cli.session_options import SESSIONS
from wam_power_ros.durable_files import printable

if TYPE_CHECKING:
    from wam_power_ros.practice.session import Session
    from wam_power_ros.practice.settings import SessionSettings

LINE = ("session", "task", "preset", "learner", "rollouts", "best return", "outcome", "begun")


def add_to(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    parser = add_command(subparsers, "sessions", sessions, "list sessions, or compare two")
    help_folder = f"a folder of sessions (default: {SESSIONS}); or sessions, to compare them"
    parser.add_argument("folder", type=Path, nargs="*", help=help_folder)


def sessions(folder: Sequence[Path]) -> None:
    """List the sessions of folders, or compare several that are named."""
    from wam_power_ros.practice.session import Session, read

    if folder[1:] and all(map(Session.exists, folder)):
        return _compare([read(path) for path in folder])
    below = [each for path in folder or [SESSIONS] for each in (path, *sorted(path.glob("*")))]
    found = [path for path in below if Session.exists(path)]
    if not found:
        raise UsageError(f"no session in {', '.join(map(str, folder or [SESSIONS]))}")
    rows: list[Mapping[str, str]] = [dict(zip(LINE, LINE, strict=True))]
    for path in found:
        try:
            rows.append(_facts(read(path)))
        except (ValueError, OSError) as error:
            why = str(error).removeprefix(f"{path}: ")
            rows.append({"session": printable(path), "outcome": f"cannot be read: {why}"})
    whole = [row for row in rows if "begun" in row]  # a long reason moves no column
    widths = {key: max(len(row[key]) for row in whole) for key in LINE}
    for row in rows:
        print("  ".join(f"{row.get(key, ''):{widths[key]}}" for key in LINE).rstrip())


def _compare(found: Sequence[Session]) -> None:
    """Print a column for each session: what there is to say, then the settings that differ."""
    columns = [_facts(each) for each in found]
    settings = [dict(_flat(each.header.settings.model_dump())) for each in found]
    for key in dict.fromkeys(key for each in settings for key in each):
        values = [str(each.get(key, "–")) for each in settings]
        for column, value in zip(columns, values if len({*values}) > 1 else [], strict=False):
            column.setdefault(key, value)
    columns = [{key: key for key in columns[0]}, *columns]
    widths = [max(map(len, column.values())) for column in columns]
    for key in columns[0]:
        cells = (f"{each[key]:{width}}" for each, width in zip(columns, widths, strict=True))
        print("  ".join(cells).rstrip())


def _facts(session: Session) -> dict[str, str]:
    """What there is to say about a session, by name; `LINE` are the first of them."""
    from wam_power_ros.reporting.terminal import number, spark

    settings, records = session.header.settings, session.records
    tests = [record for record in records if record.kind == "retest"]
    returns, tested = ([r.ret for r in of if r.ret is not None] for of in (records, tests))
    judged, kind = (tests, "re-tests") if tests else (records, "rollouts")
    outcome = f"{sum(record.succeeded for record in judged)} of {len(judged)} {kind} succeeded"
    if len(tested) < settings.practice.retests:
        outcome += ", not ended"
    begun = time.localtime((session.folder / "session.yaml").stat().st_mtime)
    return {
        "session": printable(short_path(session.folder.resolve())),
        "task": settings.task,
        "preset": _preset(settings),
        "learner": settings.learner,
        "rollouts": str(len(records)),
        "best return": number(max(returns, default=None)),
        "outcome": outcome,
        "begun": time.strftime("%Y-%m-%d %H:%M", begun),
        "seed": str(session.header.seed),
        "demonstrations": str(len(session.header.candidates)),
        "returns": spark(returns, 40),
        "first return": number(returns[0] if returns else None),
        "first success": next((str(each.number) for each in records if each.succeeded), "–"),
        "mean of the re-tests": number(sum(tested) / len(tested) if tested else None),
        "faults": str(sum(bool(record.fault) for record in records)),
    }


def _preset(settings: SessionSettings) -> str:
    """Preset with these settings of task and learner; "changed" if there is none."""
    from wam_power_ros.practice.settings import preset

    for name in installed.task_type(settings.task).presets:
        given = preset(settings.task, name)
        if given.model_copy(update={"practice": settings.practice}) == settings:
            return name
    return "changed"


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Values by dotted name."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
