# SPDX-License-Identifier: Apache-2.0
"""The commands of `wam-power`; each takes its options, as `cli.main` has parsed them, by name."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from ctypes.util import find_library
from pathlib import Path
from typing import TYPE_CHECKING

from wam_power_ros.cli.keys import passing_keys
from wam_power_ros.cli.launcher import (
    Devices,
    Launcher,
    UsageError,
    folder_lock,
    launch,
    learner_is_running,
    session_domain,
    short_path,
    timestamp,
)
from wam_power_ros.cli.plan import LEARNER, RECORDER, TRACKER, Plan
from wam_power_ros.cli.processes import NodeLogs, ProcessError, Processes, Running
from wam_power_ros.cli.session_options import (
    DEFAULT_TASK,
    SESSIONS,
    SessionOptions,
    chosen,
    chosen_settings,
    existing_session,
    learner_parameters,
    with_origin,
)
from wam_power_ros.durable_files import check_name, printable
from wam_power_ros.entry import INTERRUPTED
from wam_power_ros.params import overlay

if TYPE_CHECKING:
    from wam_power_ros.practice.session import Session

LINE = ("session", "task", "learner", "rollouts", "best return", "outcome", "begun")
RATINGS = tuple("0123456789")  # of a rollout, from worst to as it should be

# On the arm or its stand-in


def teach(
    task: str | None, folder: Path | None, demonstrations: int, seed: int | None, devices: Devices
) -> int:
    """Record demonstrations and add them to the series of the folder."""
    from wam_power_ros.bags import series
    from wam_power_ros.reporting.terminal import counted

    folder = (folder or Path("demonstrations") / timestamp()).resolve()
    file = folder / series.FILE
    before, text = len(series.read(file)), ""
    if before:
        text = f"{short_path(folder)} holds {counted(before, 'demonstration')}; new ones are added."
    seed = before if seed is None else seed  # so that new movements differ
    status = 0
    try:
        parameters = devices.parameters(task or DEFAULT_TASK, seed, folder)
        plan = Plan(folder, parameters, devices.stand_ins)
        with launch(plan, text) as launcher:
            _teach(launcher, file, demonstrations, review=sys.stdin.isatty())
    except KeyboardInterrupt:
        status = INTERRUPTED
        print("\nStopped.")
    if bags := series.read(file):
        taught = counted(len(bags), "demonstration")
        print(f"To learn from {taught}: wam-power learn --bags {short_path(folder)}/bags/*")
    return status


def learn(
    asked: SessionOptions, session: Path | None, devices: Devices, in_process: bool = False
) -> int:
    """Start or resume a session, run it to its end and write its report."""
    from wam_power_ros import installed
    from wam_power_ros.practice.session import Session, read

    if in_process and installed.task_type(asked.task or DEFAULT_TASK).rated:
        raise UsageError(f"a person rates the task {asked.task}: learn it without --in-process")
    if in_process and (asked.bags or asked.origin or not devices.stand_ins):
        raise UsageError(
            "--in-process simulates arm and demonstrations: it takes no --bags, no --from, and "
            "--config only with --simulate"
        )
    folder = (session or SESSIONS / f"{timestamp()}-seed-{asked.seed or 0}").resolve()
    asked = with_origin(asked, devices)
    seed, task = chosen(folder, asked, devices)
    if resumed := Session.exists(folder):
        begun = read(folder)
        if _has_ended(begun):
            return _report_ended(begun)
        text = f"Resuming {folder} with {len(begun.records)} recorded rollouts."
    else:
        text = f"New session {folder}; Ctrl-C stops it, and it can be resumed."
    try:
        parameters = devices.parameters(task, seed, folder)
        if in_process:
            print(text)
            return _learn_in_process(folder, asked, seed, task, parameters)
        given = learner_parameters(folder, asked, seed, task)
        parameters = parameters.changed({LEARNER: given})
        also = (TRACKER, LEARNER)
        plan = Plan(folder, parameters, devices.stand_ins, also)
        with launch(plan, text) as launcher:
            taught: dict[str, list[str]] = {}
            if not resumed and not asked.bags:
                bags = _record_demonstrations(launcher, folder, asked.demonstrations)
                taught = {"demonstrations": [*map(str, bags)]}
            practising = launcher.node(LEARNER, **taught)
            _follow(folder, launcher.processes, practising)
    except KeyboardInterrupt:
        print("\nStopped.")
        _print_how_to_go_on(folder)
        return INTERRUPTED
    except ProcessError as error:  # the advice comes last, below the end of the log
        print(f"wam-power: {error}", file=sys.stderr, flush=True)
        _print_how_to_go_on(folder)
        return 2
    _print_summary(read(folder))
    return report(folder)


def _learn_in_process(
    folder: Path, asked: SessionOptions, seed: int, task: str, parameters: overlay.Setup
) -> int:
    """Teach and learn in simulation without nodes, and write the report."""
    from wam_power_ros.in_process import learn as in_process
    from wam_power_ros.practice.settings import of_parameters
    from wam_power_ros.reporting import terminal

    with folder_lock(folder), terminal.Display() as display:
        for file, text in Plan(folder, parameters, stand_ins=True).written.items():
            file.write_text(text, encoding="utf-8")
        settings = of_parameters(parameters["learner"] | chosen_settings(asked, task))
        for session in in_process.run(folder, parameters, settings, seed, asked.demonstrations):
            display.show(session.log, session.header.settings, session.task)
    _print_summary(session)
    return report(folder)


def _print_how_to_go_on(folder: Path) -> None:
    print(f"To go on: the same command with --session {short_path(folder)}")


def _has_ended(session: Session) -> bool:
    """Whether all re-tests, the last rollouts of a session, are recorded."""
    done = sum(record.kind == "retest" and record.ret is not None for record in session.records)
    return 0 < session.header.settings.practice.retests <= done


def _report_ended(session: Session) -> int:
    """Print the result of a session that has ended and how to practise longer; start nothing."""
    folder = session.folder
    print(f"{short_path(folder)} has ended: all its re-tests are recorded. Nothing is started.")
    _print_summary(session)
    print(f"A new session goes on from its policy: wam-power learn --from {short_path(folder)}")
    return 0 if (folder / "report.html").is_file() else report(folder)


def _print_summary(session: Session) -> None:
    """Print how a session practised, and its result."""
    from wam_power_ros.practice.failure import why_failed
    from wam_power_ros.reporting import terminal

    settings = session.header.settings
    method, records = settings.described(session.task), session.records
    lines = [f"{method[0].upper()}{method[1:]}", terminal.summary(records, session.task)]
    lines += terminal.failed(why_failed(records, session.task, settings, session.start))
    print(terminal.wrapped("\n".join(lines)))


def replay(bag: Path, speed: float, task: str | None, folder: Path | None, devices: Devices) -> int:
    """Repeat a recorded movement with the arm."""
    from wam_power_ros.bags import reader
    from wam_power_ros.bags.bag import Bag
    from wam_power_ros.console import replay as replaying
    from wam_power_ros.control import replay_trajectory

    if bag.is_file() and bag.suffix == ".json":
        raise UsageError(f"{bag} is not a bag; to execute a policy: wam-power run-policy {bag}")
    folder = (folder or Path("replays") / timestamp()).resolve()
    parameters = devices.parameters(task or "", folder=folder)
    parameters = parameters.changed({RECORDER: {"stem": "replay"}})
    arm = parameters.arm()
    states = reader.read_states(Bag(bag), parameters.joint_names, arm=arm and arm.identity())
    for remark in states.remarks:
        print(f"{bag}: {remark.text}")
    movement = replay_trajectory.movement(states.stamps, states.q, speed)
    plan = Plan(folder, parameters, devices.stand_ins)
    with launch(plan) as launcher, launcher.robot() as robot:
        name, person = bag.resolve().name, not devices.stand_ins
        return replaying.replay(robot, name, *movement, speed, person)


def run_policy(
    policy: Path, rollouts: int, task: str | None, folder: Path | None, devices: Devices
) -> int:
    """Execute a saved policy with the arm, as often as asked."""
    from wam_power_ros.console import run_policy as running
    from wam_power_ros.practice.session import Session, read, read_policy

    file = policy / "policy.json" if policy.is_dir() else policy
    beside = file.resolve().parent
    session = read(beside) if Session.exists(beside) else None
    name = task or (session.header.settings.task if session else DEFAULT_TASK)
    folder = (folder or Path("runs") / timestamp()).resolve()
    parameters = devices.parameters(name, folder=folder).changed(
        {LEARNER: {"record_rollouts": True}}
    )
    if (arm := parameters.arm()) is None:
        raise UsageError("the set-up has no URDF file of the arm: choose one with --config")
    saved = read_policy(file, arm.identity())
    scoring, unscored = running.task_of(session, name)
    plan = Plan(folder, parameters, devices.stand_ins, (TRACKER,))
    with launch(plan) as launcher, launcher.robot() as robot:
        if unscored:
            print(f"No returns: {unscored}")
        status = running.run(robot, saved, scoring, rollouts, person=not devices.stand_ins)
    print(f"Bags: {short_path(folder / 'bags')}")
    return status


def _record_demonstrations(launcher: Launcher, folder: Path, wanted: int) -> list[Path]:
    """Record the demonstrations that a session lacks; return the bags of all.

    A person continues an interrupted series. The simulated demonstrator starts over: its movements
    depend on the seed and on how many it has made since the stand-in was started.
    """
    from wam_power_ros.bags import series

    file = folder / series.FILE
    recorded = series.read(file)
    if len(recorded) < wanted:
        person = not launcher.plan.stand_ins
        if recorded and not person:
            for bag in filter(Path.is_dir, recorded):
                series.discard(bag)
            recorded = []
            series.write(file, recorded)
        review = person and sys.stdin.isatty()
        _teach(launcher, file, wanted - len(recorded), review)
    return series.read(file)


def _teach(launcher: Launcher, file: Path, count: int, review: bool) -> None:
    """Record demonstrations and add them to a series."""
    from wam_power_ros.console.teach import record_series
    from wam_power_ros.reporting.terminal import counted

    person = not launcher.plan.stand_ins
    teacher = "a person" if person else "the simulated demonstrator"
    print(f"Teaching: {counted(count, 'demonstration')} by {teacher}", flush=True)
    with launcher.robot() as robot:
        record_series(robot, file, count, person=person, review=review)


def _follow(folder: Path, processes: Processes, learner: Running) -> None:
    """Display a session until its learner ends."""
    from wam_power_ros.practice import session
    from wam_power_ros.reporting import terminal

    path, logs = folder / "rollouts.jsonl", NodeLogs(folder / "logs")
    size_shown = 0
    ended = False
    with terminal.Display() as display, passing_keys(session_domain(folder)) as poll:
        while not ended:
            display.footer = poll()
            ended = learner.process.poll() is not None
            processes.check(but=learner)
            size = path.stat().st_size if path.exists() else 0
            if size != size_shown:
                size_shown = size
                found = session.read(folder)
                display.show(found.log, found.header.settings, found.task)
            for message, is_problem in logs.new():
                display.show_message(message, is_problem)
            time.sleep(0.2)
    if learner.process.returncode:
        raise learner.error()


# Sessions


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


def feedback(kind: str, given: str | None, session: Path | None) -> int:
    """Pass a person's feedback to the learner of a running session, or stop its arm."""
    needed = {"demonstration": "a bag", "rate": "a number from 0 to 9"}.get(kind, "nothing")
    if (given is None) != (needed == "nothing") or (kind == "rate" and given not in RATINGS):
        raise UsageError(f"{kind} needs {needed} after it, not {given or 'nothing'}")
    folder = existing_session(session)
    if kind != "stop" and not learner_is_running(folder):  # an arm may move without a learner
        raise UsageError(f"no learner is running in {short_path(folder)}")
    from wam_power_ros.client.feedback import answered, connected

    value = int(given) / 9.0 if kind == "rate" else None
    bag = Path(given) if kind == "demonstration" else None
    with connected(session_domain(folder)) as link:
        answer = answered(lambda: link.give(kind, bag, value))
    print(answer.text if answer.success else f"refused: {answer.text}")
    return 0 if answer.success else 2


def view(path: Path | None, address: str, port: int) -> int:
    """Serve a page that shows a session, until Ctrl-C."""
    from wam_power_ros.practice.session import Session

    print("Preparing the page …", file=sys.stderr, flush=True)
    from wam_power_ros.view import guarded_server, session_page

    if path is not None:
        check_name(path)
    if path is not None and not Session.exists(path) and session_page.running(path):
        print(f"{path} is being taught; the page opens with its session", file=sys.stderr)
        while not Session.exists(path):
            if not session_page.running(path):
                raise UsageError(f"{path} has ended before its session began")
            time.sleep(1.0)
    folder = existing_session(path)
    server = guarded_server.GuardedServer(address, port)
    try:
        host = f"[{address}]" if ":" in address else address
        url = f"http://{host}:{server.get_port()}"
        ready = lambda: print(f"{url}  (Ctrl-C ends it)", flush=True)  # noqa: E731
        session_page.of_session(server, folder, ready, session_domain)
    except KeyboardInterrupt:
        pass
    finally:
        server.stop()
    return 0


def report(session: Path) -> int:
    """Write the report of a session, with a film of the arm if it was simulated."""
    from rich.console import Console

    from wam_power_ros.practice.session import read
    from wam_power_ros.reporting import session_report

    records = read(session).records
    with Console(stderr=True).status("writing the report …"):
        if any(record.truth for record in records):
            _report_with_film(session)
        else:
            session_report.write(session)
    print(f"Report: {short_path(session.resolve() / 'report.html')}")
    return 0


def _report_with_film(folder: Path) -> None:
    """Write the report of a simulated session, with a film if this machine can render one.

    Another process executes the final policy again in the set-up of the session; if it cannot,
    because the set-up or a file that it names is missing, the report has no such rollout.
    """
    from wam_power_ros.reporting import session_report

    command = [sys.executable, "-m", "wam_power_ros.in_process.session_answer", str(folder)]
    gl = os.environ.get("MUJOCO_GL", "egl")
    if (error := _last_error(command, gl)) is not None:
        if gl == "egl" and not all(map(find_library, ("EGL", "GL"))):
            error = "MuJoCo draws with EGL: apt install libegl1 libgl1"
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


# Set-ups, bags


def config(devices: Devices, task: str | None) -> None:
    """Print the parameters of every node, once each would accept its own."""
    from hardware_sim.settings import ArmSimParams, OptitrackSimParams
    from wam_power_ros.cli.set_up_checks import mistakes
    from wam_power_ros.nodes.demonstration_recorder import DemonstrationRecorderParams
    from wam_power_ros.nodes.learner import LearnerParams
    from wam_power_ros.params.driver_params import DRIVERS

    setup = devices.parameters(task or DEFAULT_TASK)
    stand_ins = (ArmSimParams, OptitrackSimParams) if devices.stand_ins else ()
    for node in (DemonstrationRecorderParams, LearnerParams, *DRIVERS, *stand_ins):
        node.from_setup(setup)
    if wrong := [*mistakes(setup)]:
        raise ValueError("; ".join(wrong))
    print(overlay.text(setup), end="")
