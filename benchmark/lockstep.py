# SPDX-License-Identifier: Apache-2.0
"""Wall and simulated time of the rollouts of a lockstep session over DDS, by part.

    python -m benchmark.lockstep [--task reach] [--trials 8] [--demonstrations 1] [--seed 41]

Runs `wam-power learn` with the stand-ins; in its learner, the steps of a trial are timed. A step
with much simulated time waits for the ticks of the simulation, one with little for the middleware,
the disk or another process. Then the CPU time of each process is printed, by tick.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from benchmark.sessions import learn_command, learn_environment, session_parser
from wam_power_ros.cli import commands
from wam_power_ros.cli import main as command_line
from wam_power_ros.cli.plan import LEARNER, Plan
from wam_power_ros.entry import ONE_THREAD

REPORT = "WAM_POWER_LOCKSTEP_REPORT"  # environment variable: file for the times, in the learner
WHOLE = "whole trial"
TICK = 0.002  # [s]
Times = dict[str, list[tuple[float, float]]]  # by step: wall and simulated time of each [s]


def practise(file: Path) -> int:
    """Run the learner, and write the times of the steps of its trials to a file."""
    from wam_power_ros.client.requests import Requests
    from wam_power_ros.client.rollouts import Rollouts
    from wam_power_ros.nodes import learner
    from wam_power_ros.practice.practice import Practice
    from wam_power_ros.practice.session import Session

    spent: Times = defaultdict(list)
    cpu: list[dict[str, float]] = []  # before each trial
    inner = [np.zeros(2)]  # time of the steps within each step that is under way
    nodes: list[learner.Learner] = []

    def now() -> np.ndarray:
        return np.array([time.perf_counter(), nodes[0].get_clock().now().nanoseconds * 1e-9])

    def time_of(owner: type, name: str, label: Callable[..., str]) -> None:
        function = getattr(owner, name)

        def timed(*args: object, **more: object) -> object:
            if owner is learner.Learner:
                nodes[:] = [args[0]]
                cpu.append(cpu_times())
            if not nodes:
                return function(*args, **more)
            inner.append(np.zeros(2))
            begun = now()
            try:
                return function(*args, **more)
            finally:
                took, within = now() - begun, inner.pop()
                text = label(*args)
                spent[text].append(tuple(took if text == WHOLE else took - within))
                inner[-1] += took

        setattr(owner, name, timed)

    time_of(learner.Learner, "_trial", lambda *_: WHOLE)
    time_of(Practice, "next_trial", lambda *_: "next policy, with its feasibility")
    time_of(Requests, "begin", lambda _, do: f"request {do}: until it has begun")
    time_of(Rollouts, "_ask", lambda _, requests, do, *rest: f"request {do}: until its end")
    time_of(Rollouts, "_prepare", lambda *_: "body ready, retries")
    time_of(Rollouts, "_begin_bag", lambda *_: "bag: begin")
    time_of(Rollouts, "_end_bag", lambda *_: "bag: end")
    time_of(Rollouts, "_collect", lambda *_: "paths, ground truth")
    time_of(Practice, "learn", lambda *_: "return and learning")
    time_of(Session, "append", lambda *_: "log to disk")
    time_of(Session, "save_policy", lambda *_: "best policy to disk")
    status = learner.main()
    used = {name: cpu[-1][name] - cpu[1][name] for name in cpu[1]}
    file.write_text(json.dumps([spent, used]))
    return status


def cpu_times() -> dict[str, float]:
    """CPU time so far of the processes of the session, children and their children [s]."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_text().partition("\0--ros-args")[0].split("\0")
            stat = (folder / "stat").read_text().rpartition(")")[2].split()
            above = (folder.parent / stat[1] / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if str(os.getppid()) in (stat[1], above[1]):
            seconds = sum(map(int, stat[11:13])) / os.sysconf("SC_CLK_TCK")
            found[words[-1].rpartition(".")[2]] = seconds
    return found


def table(spent: Times, cpu: dict[str, float]) -> str:
    """Format the times of all trials but the first as text."""
    lines = [f"  {'step':44s}{'median [ms]':>12s}{'mean [ms]':>11s}{'simulated [ms]':>16s}"]
    trials = slice(1, len(spent[WHOLE]) - 1)  # the last call finds that there is none left
    kept = {label: np.array(rows[trials]) for label, rows in spent.items() if rows[trials]}
    for label, rows in sorted(kept.items(), key=lambda item: -np.mean(item[1][:, 0])):
        median, (mean, simulated) = 1e3 * np.median(rows[:, 0]), 1e3 * rows.mean(axis=0)
        lines.append(f"  {label:44s}{median:12.1f}{mean:11.1f}{simulated:16.1f}")
    wall, simulated = kept[WHOLE].sum(axis=0)
    ticks = simulated / TICK
    lines.append(f"  ticks a second: {ticks / wall:.0f}")
    lines += [f"  CPU of {name}: {1e6 * used / ticks:.0f} us a tick" for name, used in cpu.items()]
    return "\n".join(lines)


def timed_plan(plan: Plan) -> Plan:
    """The plan of a session whose learner is that of this module."""
    timed = []
    for process in plan.processes:
        python, _, _, _, *arguments = process.command
        command = (python, "-m", "benchmark.lockstep", *arguments)
        timed.append(replace(process, command=command) if process.name == LEARNER else process)
    return replace(plan, processes=tuple(timed))


def main() -> int:
    """Run a session and print the times of its steps."""
    if file := os.environ.get(REPORT):
        return practise(Path(file))
    parser = session_parser(__doc__, seed=41)
    parser.set_defaults(demonstrations=1)
    parser.add_argument("--task", default="reach")
    options = parser.parse_args()
    plan_of = commands.plan_of
    with tempfile.TemporaryDirectory() as scratch:
        folder, report = options.folder or Path(scratch) / "session", Path(scratch) / "times.json"
        os.environ |= {**learn_environment(), **ONE_THREAD, REPORT: str(report)}
        words = [*learn_command(folder, options)[3:], "--task", options.task]
        with patch.object(commands, "plan_of", lambda *a, **b: timed_plan(plan_of(*a, **b))):
            status = command_line.main(words)
        if report.exists():
            print(f"rollouts of {options.task}, seed {options.seed}, without the first")
            print(table(*json.loads(report.read_text())))
    return status


if __name__ == "__main__":
    sys.exit(main())
