# SPDX-License-Identifier: Apache-2.0
"""Kill the learner (-9) repeatedly: its session must end with the records of an undisturbed one.

    python -m benchmark.kill [--seed 42] [--kills 10] [--trials 8] [--demonstrations 4]
    python -m benchmark.kill --each 20 --trials 6

First an undisturbed session is run. Then another session learns from the same bags, on nodes that
keep running. Its learner is killed at random moments (drawn from the seed), up to five seconds
after its start or after its first rollout, and restarted with the same folder. No line that
`rollouts.jsonl` had before a kill may change. In the end all fields must be equal except `clock`
and `bag`: a recording that a kill cut short keeps its name, so the repeated rollout is in
rollout_<id>_2.

With `--each`, that many sessions of `wam-power learn` lose one process each (-9), in turn each of
its nodes, its preparation process, and `wam-power` itself, at a random moment. They are resumed by
the same command, and compared with the undisturbed session.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmark.nodes import environment, node_command
from benchmark.sessions import (
    differences,
    learn,
    learn_command,
    learn_environment,
    lines,
    records,
    session_parser,
    verdict,
)
from wam_power_ros.bags.layout import UNFINISHED
from wam_power_ros.cli.processes import Processes
from wam_power_ros.ros.domain import private_domain

ROLLOUT_TIMEOUT = 120.0  # [s]
PROCESSES = (  # of `wam-power learn`, and itself
    "learner",
    "torque_controller",
    "wam_sim",
    "pancake_tracker",
    "demonstration_recorder",
    "preparation_worker",
    "wam-power",
)


def learn_killed(
    folder: Path, bags: list[str], seed: int, trials: int, kills: int
) -> tuple[list[str], list[str]]:
    """Run a session whose learner is killed `kills` times, or until the session is over.

    Returns:
        Descriptions of lost lines, and a report line for every kill.
    """
    rng = np.random.default_rng(seed)
    lost, report, kept = [], [], []
    command = node_command(
        "learner",
        "simulation",
        use_sim_time=True,
        session=str(folder),
        seed=seed,
        trials=trials,
        demonstrations=bags,
    )
    with private_domain() as domain:
        others = Processes(folder / "logs", environment(domain))
        learners = Processes(folder / "logs", environment(domain))
        with others, learners:
            others.start("wam_sim", node_command("wam_sim", pace="lockstep", seed=seed))
            for name in ("torque_controller", "pancake_tracker"):
                others.start(name, node_command(name, "simulation", use_sim_time=True))
            directory = str(folder / "bags")
            recorder = "demonstration_recorder"
            given = {"use_sim_time": True, "directory": directory}
            others.start(recorder, node_command(recorder, **given))
            for kill in range(1, kills + 1):
                rollouts, life = int(rng.integers(2)), float(rng.uniform(0.2, 5.0))
                learner = learners.start("learner", command)
                end = time.monotonic() + ROLLOUT_TIMEOUT
                while len(lines(folder)) < len(kept) + rollouts and time.monotonic() < end:
                    time.sleep(0.01)
                time.sleep(life)
                if learner.process.poll() == 0:  # finished before it was killed
                    report.append(f"  the session was over after {kill - 1} kills")
                    break
                if learner.process.poll() is not None or time.monotonic() > end:
                    raise RuntimeError(f"no session to kill ({kill})\n{learner.tail}")
                before = lines(folder)
                learner.process.kill()
                learner.process.wait()
                others.check()
                recording = any((folder / "bags").glob(f"*{UNFINISHED}"))
                for old in (kept, before):
                    if lines(folder)[: len(old)] != old:
                        lost.append(f"kill {kill}: a line that was on disk has changed")
                kept = lines(folder)
                report.append(
                    f"  {kill:2d}: {life:3.1f} s after its {('start', 'first rollout')[rollouts]}, "
                    f"{len(kept)} records{', recording' * recording}"
                )
            last = Processes(folder / "logs", environment(domain))
            with last:
                last.finish(last.start("learner", command))
            others.check()
    if lines(folder)[: len(kept)] != kept:
        lost.append("a line that was on disk has changed after the last kill")
    return lost, report


def descendants(parent: int) -> dict[str, int]:
    """Processes below a process: what they run, and their ids."""
    rows: dict[int, tuple[int, list[str]]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_text().split("\0")
            above = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:  # it has ended
            continue
        rows[int(folder.name)] = above, words
    found: dict[str, int] = {}
    below = {parent}
    while new := {pid for pid, (above, _) in rows.items() if above in below} - below:
        below |= new
        for pid in new:
            words = rows[pid][1]
            for name in PROCESSES[:-1]:
                if name in words or any(word.endswith(f".{name}") for word in words):
                    found[name] = pid
    return found


def learn_bereaved(folder: Path, options: argparse.Namespace, name: str, seed: int) -> str:
    """Run a session that loses a process (-9) at a random moment, and resume it to its end.

    Args:
        folder: Folder of the session.
        options: Those of `session_parser`.
        name: One of `PROCESSES`.
        seed: Seed of the moment.

    Returns:
        A line for the report.
    """
    rng = np.random.default_rng(seed)
    count, late = int(rng.integers(options.trials)), float(rng.uniform(0.0, 2.0))
    command = learn_command(folder, options)
    folder.mkdir(parents=True)
    with (folder / "learn.log").open("ab") as log:
        running = subprocess.Popen(command, env=learn_environment(), stdout=log, stderr=log)
    end = time.monotonic() + ROLLOUT_TIMEOUT
    while len(lines(folder)) < count and time.monotonic() < end and running.poll() is None:
        time.sleep(0.01)
    time.sleep(late)
    victims = descendants(running.pid) | {PROCESSES[-1]: running.pid}
    while name not in victims and time.monotonic() < end and running.poll() is None:
        time.sleep(0.01)
        victims = descendants(running.pid) | {PROCESSES[-1]: running.pid}
    if name not in victims or running.poll() is not None:
        raise RuntimeError(f"no {name} to kill; status {running.poll()}")
    os.kill(victims[name], signal.SIGKILL)
    before = len(lines(folder))
    status = running.wait(2.0 * ROLLOUT_TIMEOUT)
    resumed = 0
    while status and resumed < 3:
        resumed += 1
        status = subprocess.run(
            command,
            env=learn_environment(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            stdin=subprocess.DEVNULL,
        ).returncode
    return f"{name} killed at {before} records, resumed {resumed} times, status {status}"


def each(folder: Path, options: argparse.Namespace) -> int:
    """Kill one process in each of `options.each` sessions; status 1 if a record differs."""
    learn(folder / "undisturbed", options)
    expected, bad = records(folder / "undisturbed", "clock", "bag"), 0
    for number in range(options.each):
        session, name = folder / f"killed-{number}", PROCESSES[number % len(PROCESSES)]
        report = learn_bereaved(session, options, name, options.seed + 100 * number)
        found = [*differences(expected, records(session, "clock", "bag"))]
        bad += bool(found)
        print(f"{report}; {verdict(f'{len(expected)} rollouts', found)}", flush=True)
    print(f"{bad} of {options.each} sessions differ")
    return int(bad > 0)


def main() -> int:
    """Run both sessions and print the differences; status 1 if there are any."""
    parser = session_parser(__doc__, seed=42)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--each", type=int, default=0, help="number of sessions of wam-power learn")
    options = parser.parse_args()
    seed = options.seed
    with tempfile.TemporaryDirectory() as scratch:
        folder = (options.folder or Path(scratch)).resolve()
        if options.each:
            return each(folder, options)
        undisturbed, killed = folder / "undisturbed", folder / "killed"
        took = learn(undisturbed, options)
        bags = json.loads((undisturbed / "demonstrations.json").read_text())
        begun = time.monotonic()
        lost, report = learn_killed(killed, bags, seed, options.trials, options.kills)
        longer = time.monotonic() - begun
        found = [
            *lost,
            *differences(records(undisturbed, "clock", "bag"), records(killed, "clock", "bag")),
        ]
        for record in records(killed):
            if not (killed / "bags" / str(record["bag"]) / "metadata.yaml").exists():
                found.append(f"{record['id']}: no bag {record['bag']!r}")
        bags_left = sorted(path.name for path in (killed / "bags").iterdir())
        print(
            f"seed {seed}, {len(lines(undisturbed))} rollouts: {took:.0f} s undisturbed,", end=" "
        )
        kills = sum(" records" in line for line in report)
        print(f"{longer:.0f} s with {kills} kills", *report, sep="\n")
        print(f"bags: {len(bags_left)}, including rollouts that a kill cut short")
        print(verdict("rollouts, undisturbed and killed", found))
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
