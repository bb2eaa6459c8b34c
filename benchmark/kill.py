# SPDX-License-Identifier: Apache-2.0
"""Kill processes of a session (-9): it must end with the records of an undisturbed one.

    python -m benchmark.kill [--of learner ...] [--kills 10] [--seed 42] [--trials 8]

Two sessions of `wam-power learn` learn the same. Of the second, one process at a time is killed, at
a moment drawn from the seed: up to five seconds after its start or after a first rollout. The same
command resumes it. No line that `rollouts.jsonl` had before a kill may change. In the end all
fields must be equal except `clock` and `bag`: a recording that a kill cut short keeps its name, so
the repeated rollout is in rollout_<id>_2.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmark.nodes import environment
from benchmark.terminal import options

TIMEOUT = 240.0  # [s] for a rollout, or for the end of a session that lost a process
PROCESSES = (  # of `wam-power learn`, and itself
    *("learner", "torque_controller", "wam_sim", "pancake_tracker", "demonstration_recorder"),
    *("preparation_worker", "wam-power"),
)


def learning(folder: Path, *words: object) -> subprocess.Popen[bytes]:
    """Begin or resume a session of `wam-power learn` in a folder, without a film."""
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "wam_power_ros.cli", "learn", "--session", str(folder)]
    given = {**os.environ, **environment(), "MUJOCO_GL": "disable"}
    with (folder / "learn.log").open("ab") as log:
        nothing = subprocess.DEVNULL
        files = {"stdin": nothing, "stdout": log, "stderr": log}
        return subprocess.Popen([*command, *map(str, words)], env=given, **files)


def lines(folder: Path) -> list[bytes]:
    """Complete lines of a session's log."""
    log = folder / "rollouts.jsonl"
    return log.read_bytes().splitlines(keepends=True) if log.exists() else []


def differences(one: Path, other: Path) -> list[str]:
    """Fields of the records of two sessions that differ, bit for bit, but for what may differ."""
    logs = [[json.loads(line) for line in lines(folder)] for folder in (one, other)]
    found = [] if len(logs[0]) == len(logs[1]) else [f"{len(logs[0])} and {len(logs[1])} records"]
    for number, (a, b) in enumerate(zip(*logs, strict=False)):
        names = sorted((a.keys() | b.keys()) - {"clock", "bag"})
        found += [f"[{number}].{name}" for name in names if repr(a.get(name)) != repr(b.get(name))]
    return found


def descendants(parent: int) -> dict[str, int]:
    """Processes of a session: what they run, and their ids."""
    rows: dict[int, tuple[int, list[str]]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_text().split("\0")
            above = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:  # it has ended
            continue
        rows[int(folder.name)] = above, words
    found, below = {PROCESSES[-1]: parent}, {parent}
    while new := {pid for pid, (above, _) in rows.items() if above in below} - below:
        below |= new
        for pid in new:
            words = rows[pid][1]
            for name in PROCESSES[:-1]:
                if name in words or any(word.endswith(f".{name}") for word in words):
                    found[name] = pid
    return found


def learn_killed(
    folder: Path, words: list[object], names: list[str], kills: int, rng: np.random.Generator
) -> list[str]:
    """Run a session that loses processes in turn, until it is over; print every kill.

    Returns:
        Descriptions of what was lost.
    """
    lost, status = [], None
    for kill in range(kills):
        name, after = names[kill % len(names)], int(rng.integers(2))
        running, kept = learning(folder, *words), lines(folder)
        victims, end = descendants(running.pid), time.monotonic() + TIMEOUT
        while name not in victims or len(lines(folder)) < len(kept) + after:
            if running.poll() is not None or time.monotonic() > end:
                break
            time.sleep(0.01)
            victims = descendants(running.pid)
        time.sleep(float(rng.uniform(0.2, 5.0)))
        if running.poll() == 0:
            print(f"  the session was over after {kill} kills", flush=True)
            return lost
        if running.poll() is not None or name not in victims:
            log = (folder / "learn.log").read_text()
            raise RuntimeError(f"no {name} to kill ({kill})\n{log[-2000:]}")
        before = lines(folder)
        os.kill(victims[name], signal.SIGKILL)
        status = running.wait(TIMEOUT * 2.0)
        now = lines(folder)
        if any(now[: len(old)] != old for old in (kept, before)):
            lost.append(f"kill {kill + 1}: a line that was on disk has changed")
        print(f"  killed {name} after {len(now)} records, status {status}", flush=True)
    for _ in range(3):
        status = status and learning(folder, *words).wait()
    return lost if status == 0 else [*lost, f"the last resumption ended with status {status}"]


def main() -> int:
    """Run both sessions and print the differences; status 1 if there are any."""
    given = options(__doc__, of=[*PROCESSES], kills=10, seed=42, trials=8)
    words = ["--seed", given.seed, "--trials", given.trials, "--demonstrations", 4]
    rng = np.random.default_rng(given.seed)
    with tempfile.TemporaryDirectory() as scratch:
        undisturbed, killed = Path(scratch) / "undisturbed", Path(scratch) / "killed"
        if learning(undisturbed, *words).wait():
            raise RuntimeError((undisturbed / "learn.log").read_text()[-2000:])
        found = learn_killed(killed, words, given.of, given.kills, rng)
        found += differences(undisturbed, killed)
        for line in lines(killed):
            bag = json.loads(line)["bag"]
            if not (killed / "bags" / str(bag) / "metadata.yaml").exists():
                found.append(f"no bag {bag!r}")
        count = len(lines(undisturbed))
    for each in found[:20]:
        print(each)
    print(f"{count} rollouts, undisturbed and killed: {len(found)} differences")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
