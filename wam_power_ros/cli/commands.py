# SPDX-License-Identifier: Apache-2.0
"""The commands of `wam-power`; each takes the options that `cli.main` has parsed."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from wam_power_ros.cli.keys import Keys
from wam_power_ros.cli.launcher import (
    Launcher,
    UsageError,
    interrupt,
    launch,
    now,
    session_environment,
    setup_options,
    short_path,
    simulated,
    task_setup,
)
from wam_power_ros.cli.processes import ProcessError, Processes, Running
from wam_power_ros.params import overlay

if TYPE_CHECKING:
    from wam_power_ros.practice.session_log import Line, Record

SESSIONS = Path("sessions")
REPLAYS = Path("replays")
TASK = "flip"  # the default


# On the arm or its stand-in


def teach(options: argparse.Namespace) -> None:
    """Record a series of demonstrations."""
    from wam_power_ros.practice import plugins

    task = options.task or TASK
    plugins.task_type(task)  # refuses an unknown name before anything starts
    folder = (options.folder or Path("demonstrations") / now()).resolve()
    with launch(options, folder, options.seed or 0, task) as launcher:
        bags = _record_demonstrations(launcher, folder, options)
    again = ["--task", task] if options.task else []
    words = ["wam-power", "learn", "--bags", *map(str, map(short_path, bags)), *again]
    print(f"To learn from them:\n  {shlex.join([*words, *setup_options(options)])}")


def learn(options: argparse.Namespace) -> int:
    """Begin a session or resume one, run it to its end and write its report."""
    from wam_power_ros.practice import session
    from wam_power_ros.reporting import terminal

    folder = session_folder(options)
    resumed = session.Session.exists(folder)
    if resumed:
        header, _, records = session.read(folder)
        seed, task = header.seed, header.settings.task
        print(f"Resuming {folder} with {len(records)} recorded rollouts.")
    else:
        seed, task = options.seed or 0, options.task or TASK
        check_names(task, options)
        print(f"New session {folder}; Ctrl-C stops it, and it can be resumed.")
    signal.signal(signal.SIGTERM, interrupt)
    words = ["wam-power", "learn", "--session", str(short_path(folder)), *setup_options(options)]
    again = shlex.join(words)
    try:
        with launch(options, folder, seed, task) as launcher:
            if launcher.setup["pancake_tracker"]["body"]:
                launcher.node("pancake_tracker")
            bags = [] if resumed else [path.resolve() for path in options.bags or []]
            if not resumed and not bags:
                bags = _record_demonstrations(launcher, folder, options)
            given = {name: getattr(options, name) for name in ("learner", "preset", "trials")}
            learner = launcher.node(
                "learner",
                session=str(folder),
                seed=seed,
                task=task,
                demonstrations=[str(bag) for bag in bags] or [""],
                **{name: value for name, value in given.items() if value},
            )
            practised = _follow(folder, launcher.processes, learner)
    except KeyboardInterrupt:
        print(f"\nStopped. The session is in {short_path(folder)}. To resume:\n  {again}")
        return 130
    except ProcessError:
        print(f"\nThe session is in {short_path(folder)}. To resume:\n  {again}")
        raise
    print(terminal.summary(practised, session.read_task(folder)))
    return report(argparse.Namespace(session=folder))


def replay(options: argparse.Namespace) -> int:
    """Repeat a recorded movement with the arm."""
    from wam_power_ros import arm_identity
    from wam_power_ros.bags import reader
    from wam_power_ros.control import replay_trajectory
    from wam_power_ros.control.arm import Arm
    from wam_power_ros.params.resources import share

    controller = overlay.setup(options.config, options.simulate)["torque_controller"]
    names, identity = controller["joint_names"], None
    if controller["urdf"]:
        urdf = share(controller["urdf"]).read_text()
        model = Arm(urdf, controller["model_joint_names"], controller["tool_frame"], guarded=())
        identity = model.identity()
    recorded = reader.read_demonstration(options.bag, names, arm=identity)
    replay_trajectory.movement(*recorded, options.speed)
    folder = (options.folder or REPLAYS / now()).resolve()
    signal.signal(signal.SIGTERM, interrupt)
    changes = {"demonstration_recorder": {"stem": "replay"}}
    with launch(options, folder, 0, changes=changes) as launcher:
        replaying = launcher.script(
            "replay",
            bag=str(options.bag.resolve()),
            speed=options.speed,
            joint_names=list(names),
            arm=arm_identity.to_json(identity),
            person=not simulated(options),
        )
        while True:
            try:
                return launcher.processes.wait(replaying)
            except KeyboardInterrupt:  # the script stops the arm first; then the nodes may end
                replaying.process.send_signal(signal.SIGINT)


def enable(_: argparse.Namespace) -> int:
    """Publish the enabling switch from the keyboard."""
    from wam_power_ros.console import enabling_switch

    return enabling_switch.main()


def _record_demonstrations(
    launcher: Launcher, folder: Path, options: argparse.Namespace
) -> list[Path]:
    """Bags of the series of this folder, which is recorded now unless it is complete."""
    series = folder / "demonstrations.json"
    if not series.exists():
        person = not simulated(options)
        teacher = "a person" if person else "the simulated demonstrator"
        print(f"Teaching: {options.demonstrations} demonstrations by {teacher}")
        teaching = launcher.script(
            "teach",
            demonstrations=options.demonstrations,
            series=str(series),
            person=person,
            body=launcher.setup["pancake_tracker"]["body"],
            state_topic=launcher.setup["torque_controller"]["state_topic"],
        )
        launcher.processes.finish(teaching)
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
    with terminal.Display() as display, Keys(session_environment(folder)) as keys:
        while not over:
            display.said = keys.poll()
            over = learner.process.poll() is not None
            processes.check(but=learner)
            size = path.stat().st_size if path.exists() else 0
            if size != seen:
                seen = size
                settings, log = session.read(folder)[0].settings.practice, session.read_log(folder)
                outcome = session.read_task(folder).outcome
                display.show(log, settings.budget + settings.retests, outcome)
            time.sleep(0.2)
    return with_ratings(log)


# Sessions


def feedback(options: argparse.Namespace) -> int:
    """Give a person's feedback to the learner of a running session."""
    if (options.kind == "demonstration") != (options.bag is not None):
        raise UsageError("a bag is needed for a demonstration, and only for that")
    os.environ |= session_environment(existing_session(options.session))
    from wam_power_ros.console.feedback import give

    accepted, answer = give(options.kind, options.bag)
    print(answer if accepted else f"refused: {answer}")
    return 0 if accepted else 2


def report(options: argparse.Namespace) -> int:
    """Write the report of a session; with pictures of the arm when it was simulated."""
    from wam_power_ros.practice import session
    from wam_power_ros.reporting import session_report

    folder = options.session
    _, _, records = session.read(folder)
    if any(record.truth for record in records):
        _report_with_film(folder)
    else:
        session_report.write(folder)
    print(f"Report: {short_path(folder.resolve() / 'report.html')}")
    return 0


def session_folder(options: argparse.Namespace) -> Path:
    """Folder to begin or resume; refuses options that differ from what the session began with."""
    from wam_power_ros.practice.session import Session, read

    if options.resume:
        folder = existing_session(options.session)
    else:
        folder = (options.session or SESSIONS / f"{now()}-seed-{options.seed or 0}").resolve()
    if Session.exists(folder):
        header, _, _ = read(folder)
        if options.seed is not None and options.seed != header.seed:
            raise UsageError(f"{folder} was begun with seed {header.seed}; leave --seed out")
        if options.task not in (None, header.settings.task):
            raise UsageError(f"{folder} was begun with task {header.settings.task}")
        given = [name for name in ("learner", "preset", "trials", "bags") if getattr(options, name)]
        if given:
            raise UsageError(f"{folder} was begun already; leave --{' and --'.join(given)} out")
    return folder


def check_names(task: str, options: argparse.Namespace) -> None:
    """Refuse what is unknown or belongs to another task before anything starts.

    Raises:
        ValueError: When task, learner or preset is not known; lists the known names.
        UsageError: When a bag is a demonstration of another task, by its name, or the budget leaves
            nothing to practise.
    """
    from wam_power_ros.practice import plugins
    from wam_power_ros.practice.settings import preset

    if options.learner:
        plugins.learner_type(options.learner)
    learner = {"name": options.learner} if options.learner else None
    changes = {} if options.trials is None else {"budget": options.trials}
    budget = preset(task, options.preset or "", learner, **changes).practice.budget
    count = len(options.bags) if options.bags else options.demonstrations
    reproductions = 1 if plugins.task_type(task).together else count
    if budget <= reproductions:
        raise UsageError(
            f"a budget of {budget} rollouts leaves none to practise after "
            f"{reproductions} reproductions of demonstrations; raise --trials"
        )
    tasks: dict[str, set[str]] = {}
    for name in plugins.names(plugins.TASKS):
        recorder = overlay.setup(task=task_setup(name))["demonstration_recorder"]
        tasks.setdefault(recorder["stem"], set()).add(name)
    for bag in options.bags or []:
        of_bag = tasks.get(bag.name.partition("_")[0], {task})
        if task not in of_bag:
            raise UsageError(f"{bag} is a demonstration of {', '.join(of_bag)}, not of {task}")


def existing_session(folder: Path | None) -> Path:
    """Folder of a session, by default that of the newest one."""
    from wam_power_ros.practice.session import Session

    if folder is None:
        sessions = [path for path in SESSIONS.glob("*") if Session.exists(path)]
        if not sessions:
            raise UsageError(f"no session in {SESSIONS.resolve()}; name one with --session")
        folder = max(sessions, key=lambda path: (path / "session.yaml").stat().st_mtime)
    if not Session.exists(folder):
        raise UsageError(f"{folder} holds no session")
    return folder.resolve()


def _report_with_film(folder: Path) -> None:
    """Write the report of a simulated session, with a film if this machine can render one."""
    command = [sys.executable, "-m", "wam_power_ros.experiments.session_answer", str(folder)]
    if (error := _last_error(command, os.environ.get("MUJOCO_GL", "egl"))) is not None:
        print(f"No film in the report: {error}")
        if (error := _last_error([*command, "--no-film", error], "disable")) is not None:
            raise UsageError(f"no report: {error}")


def _last_error(command: Sequence[str], gl: str) -> str | None:
    """Run a command; last line of its error output when it failed, None when it did not."""
    ended = subprocess.run(
        command, env={**os.environ, "MUJOCO_GL": gl}, stderr=subprocess.PIPE, text=True
    )
    if ended.returncode == 0:
        return None
    return (ended.stderr.strip().splitlines() or [f"status {ended.returncode}"])[-1]


# Set-ups, bags, studies


def config(options: argparse.Namespace) -> None:
    """Print the parameters of every node."""
    setup = overlay.setup(options.config, options.simulate, task_setup(options.task or TASK))
    print(overlay.text(setup), end="")


def policy(options: argparse.Namespace) -> None:
    """Print the SROS2 policy."""
    from wam_power_ros.ros import security

    print(security.policy(security.table(overlay.setup(options.config))), end="")


def play(options: argparse.Namespace) -> None:
    """Publish the topics of a bag."""
    from wam_power_ros.console import play_bag

    signal.signal(signal.SIGTERM, interrupt)
    play_bag.play(options.bag, options.rate, options.topics, options.wait)


def recover(options: argparse.Namespace) -> None:
    """Recover damaged bags."""
    from wam_power_ros.bags.recovery import recover

    for bag in options.bag:
        print(recover(bag))


def reproduce(options: argparse.Namespace) -> int:
    """Run the studies of the paper and write their report."""
    # One thread a process: with more, sums are ordered otherwise and last digits move. To be set
    # before NumPy is imported; worker processes inherit it.
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    from wam_power_ros.experiments import jobs, reproduce

    folder = options.folder or Path("reproduction-quick" if options.quick else "reproduction")
    signal.signal(signal.SIGTERM, interrupt)
    try:
        report = reproduce.run(
            folder,
            "quick" if options.quick else "full",
            options.jobs,
            options.scheduler,
            options.only or reproduce.STUDIES,
        )
    except KeyboardInterrupt:
        again = shlex.join(sys.argv[1:] if sys.argv[1:2] == ["reproduce"] else ["reproduce"])
        print(f"\nStopped. Finished results are in {folder}. To resume:\n  wam-power {again}")
        return 130
    except jobs.JobError as error:
        print(f"wam-power: {error}Finished results are in {folder}.", file=sys.stderr)
        return 1
    print(f"Report: {short_path(report.resolve())}")
    return 0
