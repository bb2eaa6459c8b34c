# SPDX-License-Identifier: Apache-2.0
"""Complete sessions over DDS for `determinism` and `kill`, and their comparison."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from benchmark.nodes import environment


def session_parser(doc: str, seed: int) -> argparse.ArgumentParser:
    """Parser of the options that define a session; the first line of `doc` describes it."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--seed", type=int, default=seed)
    parser.add_argument("--trials", type=int, default=8)
    parser.add_argument("--demonstrations", type=int, default=4)
    parser.add_argument("--folder", type=Path, help="keep the sessions in this folder")
    return parser


def learn_command(folder: Path, options: argparse.Namespace) -> list[str]:
    """Command that runs or resumes a session in a folder."""
    command = [sys.executable, "-m", "wam_power_ros.cli", "learn", "--session", str(folder)]
    if (folder / "session.yaml").exists():  # its options are on disk
        return command
    for name in ("seed", "trials", "demonstrations"):
        command += [f"--{name}", str(getattr(options, name))]
    return command


def learn_environment() -> dict[str, str]:
    """Environment of such a command: without a film."""
    return {**os.environ, **environment(), "MUJOCO_GL": "disable"}


def learn(folder: Path, options: argparse.Namespace) -> float:
    """Run `wam-power learn` in a folder; return its wall time [s]."""
    folder.mkdir(parents=True, exist_ok=True)
    begun = time.monotonic()
    with (folder / "learn.log").open("ab") as log:
        subprocess.run(
            learn_command(folder, options),
            env=learn_environment(),
            stdout=log,
            stderr=log,
            check=True,
        )
    return time.monotonic() - begun


def lines(folder: Path) -> list[bytes]:
    """Complete lines of a session's log."""
    log = folder / "rollouts.jsonl"
    return log.read_bytes().splitlines(keepends=True) if log.exists() else []


def records(folder: Path, *without: str) -> list[dict[str, object]]:
    """Records of a session, without some fields."""
    found = [json.loads(line) for line in lines(folder)]
    return [{key: row[key] for key in row if key not in without} for row in found]


def candidates(folder: Path, *without: str) -> list[object]:
    """Fitted policies of a session, without some fields."""
    found = [json.loads(path.read_text()) for path in sorted(folder.glob("candidates/*.json"))]
    return [{key: row[key] for key in row if key not in without} for row in found]


def differences(one: object, other: object, where: str = "") -> Iterator[str]:
    """Yield a line for every leaf in which two JSON values differ, bit for bit."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted(one.keys() | other.keys()):
            yield from differences(one.get(key), other.get(key), f"{where}.{key}")
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for index, pair in enumerate(zip(one, other, strict=True)):
            yield from differences(*pair, f"{where}[{index}]")
    elif repr(one) != repr(other):
        lengths = [f"{len(x)} items" if isinstance(x, list) else repr(x) for x in (one, other)]
        yield f"{where}: {lengths[0]} and {lengths[1]}"


def verdict(what: str, found: list[str]) -> str:
    """Summarize differences: one line, followed by the first 20 differences if there are any."""
    if not found:
        return f"{what}: identical, bit for bit"
    shown = "\n".join(f"  {line}" for line in found[:20])
    return f"{what}: {len(found)} values differ\n{shown}"
