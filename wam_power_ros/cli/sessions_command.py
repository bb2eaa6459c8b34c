# SPDX-License-Identifier: Apache-2.0
"""`wam-power sessions`: list sessions by a line each."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from wam_power_ros.cli.launcher import UsageError, short_path
from wam_power_ros.cli.session_options import SESSIONS
from wam_power_ros.durable_files import printable

if TYPE_CHECKING:
    from wam_power_ros.practice.session import Session

LINE = ("session", "task", "learner", "rollouts", "best return", "outcome", "begun")


def sessions(folder: Sequence[Path]) -> None:
    """List the sessions of folders."""
    from wam_power_ros.practice.session import Session, read

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


def _facts(session: Session) -> dict[str, str]:
    """What there is to say about a session, by the names of `LINE`."""
    from wam_power_ros.reporting.terminal import number

    settings, records = session.header.settings, session.records
    tests = [record for record in records if record.kind == "retest"]
    judged, kind = (tests, "re-tests") if tests else (records, "rollouts")
    outcome = f"{sum(record.succeeded for record in judged)} of {len(judged)} {kind} succeeded"
    if sum(record.ret is not None for record in tests) < settings.practice.retests:
        outcome += ", not ended"
    begun = time.localtime((session.folder / "session.yaml").stat().st_mtime)
    return {
        "session": printable(short_path(session.folder.resolve())),
        "task": settings.task,
        "learner": settings.learner,
        "rollouts": str(len(records)),
        "best return": number(max((r.ret for r in records if r.ret is not None), default=None)),
        "outcome": outcome,
        "begun": time.strftime("%Y-%m-%d %H:%M", begun),
    }
