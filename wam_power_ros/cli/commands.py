# SPDX-License-Identifier: Apache-2.0
"""The commands of `wam-power`; each takes the options that `cli.main` has parsed."""

from __future__ import annotations

import argparse
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
    arm_of,
    interrupt,
    launch,
    learner_is_running,
    pasteable,
    program_command,
    session_environment,
    setup_options,
    short_path,
    simulated,
    task_setup,
    timestamp,
)
from wam_power_ros.cli.node_log import PROBLEMS, NodeLogs, progress_messages
from wam_power_ros.cli.processes import ProcessError, Processes, Running
from wam_power_ros.cli.session_options import (
    DEFAULT_TASK,
    check_names,
    existing_session,
    given_options,
    session_folder,
)
from wam_power_ros.console import prompt
from wam_power_ros.entry import INTERRUPTED
from wam_power_ros.params import overlay, parameter_file

if TYPE_CHECKING:
    from wam_power_ros.practice.session import SessionHeader
    from wam_power_ros.practice.session_log import Line, Record


# On the arm or its stand-in


def teach(options: argparse.Namespace) -> int:
    """Record demonstrations and add them to the series of the folder."""
    from wam_power_ros.bags import series
    from wam_power_ros.practice import plugins
    from wam_power_ros.reporting.terminal import counted

    task = options.task or DEFAULT_TASK
    plugins.task_type(task)  # raises for an unknown name before anything starts
    folder = (options.folder or Path("demonstrations") / timestamp()).resolve()
    file = folder / series.FILE
    before = len(series.read(file))
    if before:
        print(f"{short_path(folder)} holds {counted(before, 'demonstration')}; new ones are added.")
    seed = before if options.seed is None else options.seed  # so that new movements differ
    status = 0
    try:
        with launch(options, folder, seed, task) as launcher:
            _teach(launcher, file, options.demonstrations, options, review=sys.stdin.isatty())
    except KeyboardInterrupt:
        status = INTERRUPTED
        print("\nStopped.")
    if bags := series.read(file):
        words = ["learn", "--bags", *map(str, map(short_path, bags))]
        words += ["--task", task] if options.task else []
        purpose = f"To learn from {counted(len(bags), 'demonstration')}:"
        _print_command(purpose, [*words, *setup_options(options)])
    return status


def learn(options: argparse.Namespace) -> int:
    """Start or resume a session, run it to its end and write its report."""
    from wam_power_ros.practice import session
    from wam_power_ros.reporting import terminal

    folder = session_folder(options)
    resumed = session.Session.exists(folder)
    if resumed:
        header, _, records = session.read(folder)
        seed, task = header.seed, header.settings.task
        if _has_ended(header.settings.practice.retests, records):
            return _report_ended(folder, header, records, options)
        print(f"Resuming {folder} with {len(records)} recorded rollouts.")
    else:
        seed, task = options.seed or 0, options.task or DEFAULT_TASK
        check_names(task, options)
        print(f"New session {folder}; Ctrl-C stops it, and it can be resumed.")
    signal.signal(signal.SIGTERM, interrupt)

    def print_how_to_resume(text: str) -> None:
        words = ["learn", "--session", str(short_path(folder))]
        if not session.Session.exists(folder):  # the options are not on disk yet
            words += given_options(options)
        _print_command(f"{text} To resume:", [*words, *setup_options(options)])

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
            practised = _follow(folder, launcher.processes, learner, options.bell)
    except KeyboardInterrupt:
        print_how_to_resume(f"\nStopped. The session is in {short_path(folder)}.")
        return INTERRUPTED
    except ProcessError as error:  # the advice comes last, below the end of the log
        print(f"wam-power: {pasteable(str(error))}", file=sys.stderr, flush=True)
        print_how_to_resume(f"\nThe session is in {short_path(folder)}.")
        return 2
    print(terminal.wrapped(terminal.summary(practised, session.read_task(folder))))
    return report(argparse.Namespace(session=folder))


def _has_ended(retests: int, records: Sequence[Record]) -> bool:
    """Whether all re-tests, the last rollouts of a session, are recorded."""
    done = sum(record.kind == "retest" and record.ret is not None for record in records)
    return 0 < retests <= done


def _report_ended(
    folder: Path, header: SessionHeader, records: Sequence[Record], options: argparse.Namespace
) -> int:
    """Print the result of a session that has ended and how to practise longer; start nothing."""
    from wam_power_ros.practice import session
    from wam_power_ros.reporting import terminal

    print(f"{short_path(folder)} has ended: all its re-tests are recorded. Nothing is started.")
    print(terminal.wrapped(terminal.summary(records, session.read_task(folder))))
    settings = header.settings
    words = ["learn", "--task", settings.task, "--trials", str(2 * settings.practice.budget)]
    bags = map(str, map(short_path, map(Path, header.demonstrations)))
    words += ["--bags", *bags, *setup_options(options)]
    _print_command("To practise longer, in a new session on the same demonstrations:", words)
    return 0 if (folder / "report.html").is_file() else report(argparse.Namespace(session=folder))


def _print_command(purpose: str, words: Sequence[str]) -> None:
    """Print a `wam-power` command to be pasted, below its purpose."""
    print(f"{purpose}\n  {program_command()} {shlex.join(words)}")


def replay(options: argparse.Namespace) -> int:
    """Repeat a recorded movement with the arm."""
    from wam_power_ros import arm_identity
    from wam_power_ros.bags import reader
    from wam_power_ros.control import replay_trajectory

    names, arm = arm_of(overlay.setup(options.config, options.simulate))
    identity = arm and arm.identity()
    states = reader.read_states(options.bag, names, arm=identity)
    for remark in states.remarks:
        print(f"{options.bag}: {remark.text}")
    replay_trajectory.movement(states.stamps, states.q, options.speed)
    folder = (options.folder or Path("replays") / timestamp()).resolve()
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
            except KeyboardInterrupt:  # the script stops the arm before the nodes end
                replaying.process.send_signal(signal.SIGINT)


def enable(_: argparse.Namespace) -> int:
    """Publish the state of the enabling switch from the keyboard."""
    from wam_power_ros.console import enabling_switch

    return enabling_switch.main()


def _record_demonstrations(
    launcher: Launcher, folder: Path, options: argparse.Namespace
) -> list[Path]:
    """Record the demonstrations that a session lacks; return the bags of all.

    A person continues an interrupted series. The simulated demonstrator starts over: its movements
    depend on the seed and on how many it has made since the stand-in was started.
    """
    from wam_power_ros.bags import series

    file, wanted = folder / series.FILE, options.demonstrations
    recorded = series.read(file)
    if len(recorded) < wanted:
        person = not simulated(options)
        if recorded and not person:
            for bag in filter(Path.is_dir, recorded):
                series.discard(bag)
            recorded = []
            series.write(file, recorded)
        review = person and sys.stdin.isatty()
        _teach(launcher, file, wanted - len(recorded), options, review)
    return series.read(file)


def _teach(
    launcher: Launcher, file: Path, count: int, options: argparse.Namespace, review: bool
) -> None:
    """Record demonstrations and add them to a series."""
    from wam_power_ros.reporting.terminal import counted

    person = not simulated(options)
    teacher = "a person" if person else "the simulated demonstrator"
    print(f"Teaching: {counted(count, 'demonstration')} by {teacher}")
    teaching = launcher.script(
        "teach",
        demonstrations=count,
        series=str(file),
        person=person,
        review=review,
        bell=options.bell,
        body=launcher.setup["pancake_tracker"]["body"],
        state_topic=launcher.setup["torque_controller"]["state_topic"],
    )
    launcher.processes.finish(teaching)


def _follow(folder: Path, processes: Processes, learner: Running, bell: bool) -> Sequence[Record]:
    """Display a session until its learner ends; return its records."""
    from wam_power_ros.practice import session
    from wam_power_ros.practice.session_log import with_ratings
    from wam_power_ros.reporting import terminal

    path, logs = folder / "rollouts.jsonl", NodeLogs(folder / "logs")
    log: Sequence[Line] = ()
    size_shown = 0
    ended = False
    with terminal.Display() as display, Keys(session_environment(folder)) as keys:
        while not ended:
            display.footer = keys.poll()
            ended = learner.process.poll() is not None
            processes.check(but=learner)
            size = path.stat().st_size if path.exists() else 0
            if size != size_shown:
                size_shown = size
                settings, log = session.read(folder)[0].settings.practice, session.read_log(folder)
                outcome = session.read_task(folder).outcome
                display.show(log, settings.budget + settings.retests, outcome)
            for entry in logs.new():
                display.show_message(entry.text, entry.severity in PROBLEMS)
                prompt.cue(bell and entry.severity == "ERROR", "fault")
            display.tick(time.monotonic())
            time.sleep(0.2)
    return with_ratings(log)


# Sessions


def feedback(options: argparse.Namespace) -> int:
    """Pass a person's feedback to the learner of a running session."""
    if (options.kind == "demonstration") != (options.bag is not None):
        raise UsageError("a bag is needed for a demonstration, and only for a demonstration")
    folder = existing_session(options.session)
    if not learner_is_running(folder):
        raise UsageError(f"no learner is running in {short_path(folder)}")
    from wam_power_ros.console.feedback import give

    namespace = parameter_file.namespace(folder / "logs/parameters.yaml")
    answer = give(options.kind, options.bag, namespace, session_environment(folder))
    print(answer.text if answer.success else f"refused: {answer.text}")
    return 0 if answer.success else 2


def report(options: argparse.Namespace) -> int:
    """Write the report of a session, with a film of the arm if it was simulated."""
    from wam_power_ros.practice import session
    from wam_power_ros.reporting import session_report

    folder = options.session
    _, _, records = session.read(folder)
    with progress_messages("writing the report"):
        if any(record.truth for record in records):
            _report_with_film(folder)
        else:
            session_report.write(folder)
    print(f"Report: {short_path(folder.resolve() / 'report.html')}")
    return 0


def _report_with_film(folder: Path) -> None:
    """Write the report of a simulated session, with a film if this machine can render one.

    Another process executes the final policy again on the simulated WAM; if it cannot, because the
    session is of another arm, the report has no such rollout.
    """
    from wam_power_ros.reporting import session_report

    command = [sys.executable, "-m", "wam_power_ros.experiments.session_answer", str(folder)]
    if (error := _last_error(command, os.environ.get("MUJOCO_GL", "egl"))) is not None:
        print(f"No film in the report: {error}")
        if (error := _last_error([*command, "--no-film", error], "disable")) is not None:
            session_report.write(folder)


def _last_error(command: Sequence[str], gl: str) -> str | None:
    """Run a command; return the last line of its error output if it failed, else None."""
    completed = subprocess.run(
        command, env={**os.environ, "MUJOCO_GL": gl}, stderr=subprocess.PIPE, text=True
    )
    if completed.returncode == 0:
        return None
    return (completed.stderr.strip().splitlines() or [f"status {completed.returncode}"])[-1]


# Set-ups, bags, studies


def config(options: argparse.Namespace) -> None:
    """Print the parameters of every node."""
    setup = overlay.setup(
        options.config, options.simulate, task_setup(options.task or DEFAULT_TASK)
    )
    arm_of(setup)  # refuses what the controller would refuse
    print(overlay.text(setup), end="")


def policy(options: argparse.Namespace) -> None:
    """Print the SROS2 policy."""
    from wam_power_ros.ros import security

    rights = security.table(overlay.setup(options.config), options.namespace)
    print(security.policy(rights, options.namespace), end="")


def play(options: argparse.Namespace) -> None:
    """Publish the topics of a bag."""
    from wam_power_ros.console import play_bag

    signal.signal(signal.SIGTERM, interrupt)
    play_bag.play(options.bag, options.rate, options.topics, options.wait)


def reproduce(options: argparse.Namespace) -> int:
    """Run the studies of the paper and write their report."""
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
        words = sys.argv[1:] if sys.argv[1:2] == ["reproduce"] else ["reproduce"]
        _print_command(f"\nStopped. Finished results are in {folder}. To resume:", words)
        return INTERRUPTED
    except jobs.JobError as error:
        print(f"wam-power: {error}Finished results are in {folder}.", file=sys.stderr)
        return 1
    print(f"Report: {short_path(report.resolve())}")
    return 0
