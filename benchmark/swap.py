# SPDX-License-Identifier: Apache-2.0
"""One session, started on the default stand-in and resumed on stand-ins of each driver.

    python -m benchmark.swap --folder /tmp/swap

Every set-up, chosen by --config alone, resumes a copy of the same session and so executes
the same next policies. The first row, the default stand-in in lockstep, is the reference; the
others run in real time. At the end git shows whether a file of the checkout was changed.
"""

from __future__ import annotations

import argparse
import math
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from wam_power_ros.practice import session
from wam_power_ros.practice.session_log import Record

ROOT = Path(__file__).resolve().parents[1]
SET_UPS = (
    (),
    ("geodude", "natnet_ros2", "full_speed"),
    ("libbarrett", "vrpn_mocap", "full_speed"),
    ("geodude", "mocap_optitrack", "full_speed"),
    ("geodude", "motion_capture_tracking", "full_speed"),
)


def main() -> int:
    """Run all set-ups and print a table; return 1 if one is incomplete or a file changed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, required=True, help="new folder for the sessions")
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument(
        "--rollouts", type=int, default=5, help="rollouts on each stand-in (default 5)"
    )
    parser.add_argument(
        "--patience", type=float, default=900.0, help="timeout for each stand-in [s]"
    )
    options = parser.parse_args()
    before = changes()
    begun = options.folder / "begun"
    learn(begun, options.rollouts, options.patience, "--seed", str(options.seed))
    first = session.read(begun).records
    table = Table("set-up", "rollouts", "returns", "caught", "faults", "same policies", "s")
    policies: list[list[float]] = []
    short = False
    for names in SET_UPS:
        folder = options.folder / ("-".join(names) or "default")
        shutil.copytree(begun, folder)
        words = [word for name in names for word in ("--config", name)]
        start = time.monotonic()
        count = len(first) + options.rollouts
        learn(folder, count, options.patience, *words, *(["--simulate"] if names else []))
        took = time.monotonic() - start
        found = session.read(folder)
        new = list(found.records[len(first) : count])
        short |= len(new) < options.rollouts
        policies = policies or [list(record.theta) for record in new]
        table.add_row(
            " + ".join(names) or "default stand-in, lockstep", *row(new, policies), f"{took:.0f}"
        )
        for record in new:
            print(
                " + ".join(names) or "default",
                record.number,
                record.ret,
                found.task.outcome(record),
                record.why,
            )
    Console(width=150).print(table)
    after = changes()
    print(f"git diff: {'empty' if not after else after}")
    return int(short or before != after)


def learn(folder: Path, count: int, patience: float, *arguments: str) -> None:
    """Run `wam-power learn` until the session has `count` rollouts, then stop it."""
    command = [sys.executable, "-m", "wam_power_ros.cli", "learn", "--session", str(folder)]
    print("wam-power", *command[3:], *arguments, flush=True)
    process = subprocess.Popen([*command, *arguments], start_new_session=True, cwd=ROOT)
    log = folder / "rollouts.jsonl"
    end = time.monotonic() + patience
    while process.poll() is None and time.monotonic() < end:
        if log.exists() and log.read_bytes().count(b"\n") >= count:
            break
        time.sleep(0.2)
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)  # acts as Ctrl-C, also when run from a script
    process.wait(180.0)


def row(new: list[Record], policies: list[list[float]]) -> list[str]:
    """Cells of a table row: rollouts, returns, caught, faults, same policies."""
    returns = [math.nan if record.ret is None else record.ret for record in new]
    caught = sum(bool(record.truth and record.truth["caught"]) for record in new)
    same = sum(list(record.theta) == theta for record, theta in zip(new, policies, strict=False))
    return [
        str(len(new)),
        " ".join(f"{ret:.2f}" for ret in returns),
        f"{caught}",
        str(sum(bool(record.fault) for record in new)),
        f"{same}",
    ]


def changes() -> str:
    """Changes of tracked files, as reported by git."""
    command = ["git", "-C", str(ROOT), "diff", "--stat", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


if __name__ == "__main__":
    sys.exit(main())
