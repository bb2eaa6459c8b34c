# SPDX-License-Identifier: Apache-2.0
"""What the command line does with an arm: teaching, learning, replaying, and telling of it.

Each function is a command, with the options that `cli` has parsed.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from wam_power_ros.cli.launcher import (
    DOMAIN,
    Bench,
    UsageError,
    chosen,
    enclave,
    interrupt,
    now,
    open_bench,
    shown,
    simulated,
)
from wam_power_ros.cli.processes import ProcessError, Processes, Running
from wam_power_ros.params import overlay

if TYPE_CHECKING:
    from wam_power_ros.practice.session_log import Line, Record

SESSIONS = Path("sessions")
REPLAYS = Path("replays")
TASKS = {  # what may be taught -> how the recorder is set for it
    "flip": {},
    "reach": {"stem": "reach", "topics": [""], "mocap_topics": [""], "driver_topics": [""]},
}


def teach(options: argparse.Namespace) -> None:
    """Record a series of demonstrations."""
    folder = (options.folder or Path("demonstrations") / now()).resolve()
    changes = {"wam_sim": {"hand": options.task}, "demonstration_recorder": TASKS[options.task]}
    with open_bench(options, folder, options.seed or 0, changes) as bench:
        bags = _teach_series(bench, folder, options)
    if options.task == "flip":
        print("To learn from them:\n  wam-power learn --bags", *map(shown, bags), *chosen(options))


def learn(options: argparse.Namespace) -> int:
    """Begin a session or go on with one, to its end and its report."""
    from wam_power_ros.practice import session
    from wam_power_ros.reporting import terminal

    folder = _session_folder(options)
    begun = session.Session.exists(folder)
    if begun:
        header, _, records = session.read(folder)
        seed = header.seed
        print(f"Going on with {folder}: {len(records)} rollouts are on record.")
    else:
        seed = options.seed or 0
        print(f"A new session, {folder}; Ctrl-C stops it, nothing learnt is lost.")
    signal.signal(signal.SIGTERM, interrupt)
    again = " ".join(["wam-power learn --session", str(shown(folder)), *chosen(options)])
    try:
        with open_bench(options, folder, seed) as bench:
            bench.start("pancake_tracker")
            bags = [] if begun else [path.resolve() for path in options.bags or []]
            if not begun and not bags:
                bags = _teach_series(bench, folder, options)
            learner = bench.start(
                "learner",
                session=folder,
                seed=seed,
                demonstrations=json.dumps([str(bag) for bag in bags] or [""]),
                **({"preset": options.preset} if options.preset else {}),
                **({"trials": options.trials} if options.trials else {}),
            )
            records = _follow(folder, bench.processes, learner)
    except KeyboardInterrupt:
        print(f"\nStopped. What was learnt is in {shown(folder)}. To go on:\n  {again}")
        return 130
    except ProcessError:
        print(f"\nWhat was learnt is in {shown(folder)}. To go on:\n  {again}")
        raise
    print(terminal.summary(records))
    return report(argparse.Namespace(session=folder))


def tell(options: argparse.Namespace) -> int:
    """Say a word to the learner of a running session."""
    if (options.word == "demonstration") != (options.bag is not None):
        raise UsageError("a demonstration, and only that, needs a bag")
    domain = _session_folder(options) / "logs" / DOMAIN
    if domain.exists():
        os.environ |= {
            "ROS_DOMAIN_ID": domain.read_text().strip(),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }
    from wam_power_ros.console.feedback import tell as say

    taken, answer = say(options.word, options.bag)
    print(answer if taken else f"refused: {answer}")
    return 0 if taken else 2


def report(options: argparse.Namespace) -> int:
    """Write the report of a session."""
    from wam_power_ros.practice import session
    from wam_power_ros.reporting import session_report as page

    folder = options.session
    _, _, records = session.read(folder)
    if any(record.truth for record in records):
        _exhibit(folder)
    else:
        page.write(folder)
    print(f"Report: {shown(folder.resolve() / 'report.html')}")
    return 0


def replay(options: argparse.Namespace) -> int:
    """Have the arm repeat a recorded movement."""
    from wam_power_ros.bags import reader
    from wam_power_ros.control import replay_trajectory

    arm = overlay.setup(options.config, options.simulate)["torque_controller"]
    replay_trajectory.movement(
        *reader.read_demonstration(options.bag, arm["joint_names"]), options.speed
    )
    folder = (options.folder or REPLAYS / now()).resolve()
    signal.signal(signal.SIGTERM, interrupt)
    changes = {"demonstration_recorder": {"stem": "replay"}}
    with open_bench(options, folder, 0, changes) as bench:
        names = bench.setup["torque_controller"]["joint_names"]
        command = [sys.executable, "-m", "wam_power_ros.console.replay", "--ros-args"]
        command += enclave("operator")
        for given in (
            f"bag:={json.dumps(str(options.bag.resolve()))}",
            f"speed:={options.speed}",
            f"joint_names:={json.dumps(list(names))}",
            f"person:={json.dumps(not simulated(options))}",
        ):
            command += ["-p", given]
        replaying = bench.processes.start("replaying", command, talks=True)
        while True:
            try:
                return bench.processes.wait(replaying)
            except KeyboardInterrupt:  # it stops the arm first; only then may the others end
                replaying.process.send_signal(signal.SIGINT)


def _teach_series(bench: Bench, folder: Path, options: argparse.Namespace) -> list[Path]:
    """Bags of the series taught in this folder, which is taught now if it was not yet."""
    series = folder / "demonstrations.json"
    person = not simulated(options)
    if not series.exists():
        hand = "a person" if person else "the simulated hand"
        print(f"Teaching: {options.demonstrations} demonstrations, by {hand}")
        command = [sys.executable, "-m", "wam_power_ros.console.teach", "--ros-args"]
        command += enclave("operator")
        command += ["-p", f"demonstrations:={options.demonstrations}"]
        command += ["-p", f"series:={series}", "-p", f"person:={json.dumps(person)}"]
        command += ["-p", f"state_topic:={bench.setup['torque_controller']['state_topic']}"]
        command += ["-p", f"body:={json.dumps(bench.setup['pancake_tracker']['body'])}"]
        bench.processes.finish(bench.processes.start("teaching", command, talks=True))
    return [Path(bag) for bag in json.loads(series.read_text())]


def _follow(folder: Path, processes: Processes, learner: Running) -> Sequence[Record]:
    """Show the session until the learner has ended it; returns its records."""
    from wam_power_ros.practice import session
    from wam_power_ros.practice.session_log import with_ratings
    from wam_power_ros.reporting import terminal

    path = folder / "rollouts.jsonl"
    log: Sequence[Line] = ()
    seen = 0
    over = False
    with terminal.Display() as display:
        while not over:
            over = learner.process.poll() is not None
            processes.check(but=learner)
            size = path.stat().st_size if path.exists() else 0
            if size != seen:
                seen = size
                settings, log = session.read(folder)[0].settings, session.read_log(folder)
                display.show(log, settings.budget + settings.retests)
            time.sleep(0.2)
    return with_ratings(log)


def _session_folder(options: argparse.Namespace) -> Path:
    from wam_power_ros.practice.session import Session, read

    folder = options.session
    if folder is None and options.resume:
        begun = [path for path in SESSIONS.glob("*") if Session.exists(path)]
        if not begun:
            raise UsageError(f"no session in {SESSIONS.resolve()} to go on with; name --session")
        folder = max(begun, key=lambda path: (path / "session.yaml").stat().st_mtime)
    if folder is None:
        folder = SESSIONS / f"{now()}-seed-{options.seed or 0}"
    if options.resume and not Session.exists(folder):
        raise UsageError(f"{folder} holds no session to go on with")
    if Session.exists(folder):
        header, _, _ = read(folder)
        if options.seed is not None and options.seed != header.seed:
            raise UsageError(f"{folder} was begun with seed {header.seed}; leave --seed out")
        if options.preset or options.trials or options.bags:
            raise UsageError(f"{folder} was begun already; leave --preset, --trials and --bags out")
    return folder.resolve()


def _exhibit(folder: Path) -> None:
    """Write the report of a simulated session, with a film if this machine can render one."""
    command = [sys.executable, "-m", "wam_power_ros.experiments.session_answer", str(folder)]
    if (why := _failure(command, os.environ.get("MUJOCO_GL", "egl"))) is not None:
        print(f"No film of it: {why}")
        if (why := _failure([*command, "--no-film", why], "disable")) is not None:
            raise UsageError(f"no report: {why}")


def _failure(command: Sequence[str], gl: str) -> str | None:
    """Run a command; the last thing it said when it failed, None when it did not."""
    ended = subprocess.run(
        command, env={**os.environ, "MUJOCO_GL": gl}, stderr=subprocess.PIPE, text=True
    )
    if ended.returncode == 0:
        return None
    return (ended.stderr.strip().splitlines() or [f"status {ended.returncode}"])[-1]
