# SPDX-License-Identifier: Apache-2.0
"""`wam-power`: the one command line. Starts nodes, follows a session, writes its report.

The nodes are processes of their own, the same that `ros2 run wam_power_ros NODE` starts; this one
opens no socket and imports no rclpy.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from wam_power_ros import setups
from wam_power_ros.processes import ProcessError, Processes, Running, private_domain

if TYPE_CHECKING:
    from wam_power_ros.records import Line, Record

NODES = {  # executable -> module with a main(); setup.py has the same entry points
    "torque_controller": "wam_power_ros.nodes.torque_controller",
    "demonstration_recorder": "wam_power_ros.nodes.demonstration_recorder",
    "pancake_tracker": "wam_power_ros.nodes.pancake_tracker",
    "learner": "wam_power_ros.nodes.learner",
    "check_driver": "wam_power_ros.nodes.check_driver",
    "wam_sim": "hardware_sim.wam_node",
    "optitrack_sim": "hardware_sim.optitrack_node",
}
SESSIONS = Path("sessions")
DOMAIN = "ros_domain_id"  # file in a session's logs/: where its simulated nodes talk
TASKS = {  # what may be taught -> how the recorder is set for it
    "flip": {},
    "reach": {"stem": "reach", "topics": [""], "mocap_topics": [""], "driver_topics": [""]},
}
REPLAYS = Path("replays")


class UsageError(Exception):
    """What was asked for cannot be done; the message says what can."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `wam-power`; returns the exit status."""
    options = _parser().parse_args(arguments)
    try:
        return int(options.command(options) or 0)
    except (UsageError, ProcessError, OSError, ValueError) as error:
        print(f"wam-power: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="wam-power", description="Teach an arm by hand; let it practise."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    learn = commands.add_parser(
        "learn",
        help="teach and learn in simulation, or with --config on an arm; resumes a session",
        description="Start the nodes, record demonstrations, practise, write a report.",
    )
    learn.add_argument("--seed", type=_natural, help="of exploration and stand-in (default 0)")
    learn.add_argument("--trials", type=_natural, help="budget of rollouts (default: the preset's)")
    learn.add_argument(
        "--preset", choices=("flip", "paper"), help="what is learnt and when it stops (flip)"
    )
    learn.add_argument("--session", type=Path, help="folder; goes on if it holds a session")
    learn.add_argument(
        "--resume", action="store_true", help="go on; without --session with the newest one"
    )
    learn.add_argument(
        "--bags", type=Path, nargs="+", help="learn from these demonstrations; teach none"
    )
    _teaching_options(learn)
    learn.set_defaults(command=_learn)

    teach = commands.add_parser(
        "teach", help="record demonstrations", description="Record demonstrations by hand."
    )
    teach.add_argument("--seed", type=_natural, help="of the stand-in (default 0)")
    teach.add_argument(
        "--task", choices=TASKS, default="flip", help="what the simulated hand shows (flip)"
    )
    teach.add_argument("--folder", type=Path, help="for the bags (default: demonstrations/NOW)")
    _teaching_options(teach)
    teach.set_defaults(command=_teach)

    config = commands.add_parser(
        "config",
        help="print the parameters of every node under some set-ups",
        description="Print a parameter file for all nodes, as learn starts them with it; for "
        "ros2 run wam_power_ros NODE --ros-args --params-file FILE.",
    )
    config.add_argument("config", nargs="*", metavar="NAME", help=f"of {', '.join(setups.known())}")
    config.add_argument("--rehearse", action="store_true", help="with stand-ins for the devices")
    config.set_defaults(command=_config)

    policy = commands.add_parser(
        "policy",
        help="print the SROS2 policy of some set-ups",
        description="Print who may do what on the network, for ros2 security generate_artifacts.",
    )
    policy.add_argument("config", nargs="*", metavar="NAME", help="as for config")
    policy.set_defaults(command=_policy)

    tell = commands.add_parser(
        "tell",
        help="reward or punish the last rollout, or give a demonstration, while it learns",
        description="Say something to the learner of a running session.",
    )
    tell.add_argument(
        "word",
        choices=("reward", "punish", "demonstration", "pause", "continue"),
        help="reward or punish: the last finished rollout; demonstration: learn from it if it is "
        "better; pause: after the trial under way, to record one",
    )
    tell.add_argument("bag", type=Path, nargs="?", help="of the demonstration")
    tell.add_argument("--session", type=Path, help="folder (default: the newest one)")
    gone_on_with = {"resume": True, "seed": None, "preset": None, "trials": None, "bags": None}
    tell.set_defaults(command=_tell, **gone_on_with)

    report = commands.add_parser("report", help="write the report of a session")
    report.add_argument("session", type=Path, help="folder of the session")
    report.set_defaults(command=_report)

    replay = commands.add_parser(
        "replay",
        help="have the arm repeat a recorded movement, and say how well it did",
        description="The arm moves to the start of a bag and follows its joints; Ctrl-C stops it.",
    )
    replay.add_argument("bag", type=Path, help="a demonstration, or any bag with joint states")
    replay.add_argument("--speed", type=float, default=1.0, help="1 for as recorded (default)")
    replay.add_argument("--folder", type=Path, help="for its recording (default: replays/NOW)")
    _arm_options(replay)
    replay.set_defaults(command=_replay)

    play = commands.add_parser(
        "play",
        help="play a bag as topics, as ros2 bag play does, but nothing that commands an arm",
        description="Publish what was recorded, as it was recorded; no arm moves by it.",
    )
    play.add_argument("bag", type=Path, help="any bag of the common message types")
    play.add_argument("--rate", type=float, default=1.0, help="1 for as recorded (default)")
    play.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="of these alone")
    play.add_argument(
        "--wait",
        type=float,
        default=0.0,
        help="for a reader of every topic before it begins, at most [s] (default 0)",
    )
    play.set_defaults(command=_play)

    recover = commands.add_parser(
        "recover", help="make a bag of what a kill, a full disk or a bad copy has left of one"
    )
    recover.add_argument("bag", type=Path, nargs="+", help="folder of the bag, or .mcap file")
    recover.set_defaults(command=_recover)

    enable = commands.add_parser(
        "enable",
        help="an enabling switch of the keyboard, for hold_to_run",
        description="Publish /controller/enable: true while a key of this terminal is held down.",
    )
    enable.set_defaults(command=_enable)

    reproduce = commands.add_parser(
        "reproduce",
        help="the paper's results from scratch, with a report; goes on where it was stopped",
        description="Run every study of the paper in simulation and write a report of it.",
    )
    reproduce.add_argument(
        "--folder", type=Path, help="of results and report (default: reproduction)"
    )
    reproduce.add_argument(
        "--jobs", type=_natural, default=os.cpu_count(), help="processes (default: one a core)"
    )
    reproduce.add_argument(
        "--quick", action="store_true", help="a few seeds, to see that it works (minutes)"
    )
    reproduce.add_argument("--only", nargs="+", metavar="STUDY", help="of these studies alone")
    reproduce.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        default=os.environ.get("DASK_SCHEDULER_ADDRESS"),
        help="of a Dask cluster that computes instead (default: $DASK_SCHEDULER_ADDRESS)",
    )
    reproduce.set_defaults(command=_reproduce)

    run = commands.add_parser(
        "run",
        help="start one node, as ros2 run does",
        description="wam-power run NODE --ros-args ... is ros2 run wam_power_ros NODE "
        "--ros-args ...",
    )
    run.add_argument("node", choices=NODES, metavar="NODE", help=", ".join(NODES))
    run.add_argument("rest", nargs=argparse.REMAINDER, metavar="...", help="for the node")
    run.set_defaults(command=_run)
    return parser


def _teaching_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--demonstrations", type=_natural, default=3, help="how many are taught (default 3)"
    )
    _arm_options(parser)


def _arm_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--config",
        action="append",
        default=[],
        metavar="NAME",
        help="set-up of an arm's driver, a motion capture, ...: "
        f"{', '.join(setups.known())}, or a .yaml file; may be given again, the last one counts "
        "most. No stand-in is started",
    )
    parser.add_argument(
        "--rehearse",
        action="store_true",
        help="with --config: stand-ins take the place of the devices, and look like them",
    )


def _natural(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{value} is negative")
    return value


# Commands


def _run(options: argparse.Namespace) -> int:
    sys.argv = [options.node, *options.rest]
    return importlib.import_module(NODES[options.node]).main()


def _config(options: argparse.Namespace) -> None:
    print(setups.text(setups.setup(options.config, options.rehearse)), end="")


def _policy(options: argparse.Namespace) -> None:
    from wam_power_ros import access

    print(access.policy(access.table(setups.setup(options.config))), end="")


def _enable(_: argparse.Namespace) -> int:
    return importlib.import_module("wam_power_ros.enabling").main()


def _teach(options: argparse.Namespace) -> None:
    folder = (options.folder or Path("demonstrations") / _now()).resolve()
    changes = {"wam_sim": {"hand": options.task}, "demonstration_recorder": TASKS[options.task]}
    with _bench(options, folder, options.seed or 0, changes) as bench:
        bags = _teach_series(bench, folder, options)
    if options.task == "flip":
        shown = [*map(_shown, bags), *_chosen(options)]
        print("To learn from them:\n  wam-power learn --bags", *shown)


def _learn(options: argparse.Namespace) -> int:
    from wam_power_ros import live, session

    folder = _session_folder(options)
    begun = session.Session.exists(folder)
    if begun:
        header, _, records = session.read(folder)
        seed = header.seed
        print(f"Going on with {folder}: {len(records)} rollouts are on record.")
    else:
        seed = options.seed or 0
        print(f"A new session, {folder}; Ctrl-C stops it, nothing learnt is lost.")
    signal.signal(signal.SIGTERM, _interrupt)
    again = " ".join(["wam-power learn --session", str(_shown(folder)), *_chosen(options)])
    try:
        with _bench(options, folder, seed) as bench:
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
        print(f"\nStopped. What was learnt is in {_shown(folder)}. To go on:\n  {again}")
        return 130
    except ProcessError:
        print(f"\nWhat was learnt is in {_shown(folder)}. To go on:\n  {again}")
        raise
    print(live.summary(records))
    return _report(argparse.Namespace(session=folder))


def _reproduce(options: argparse.Namespace) -> int:
    # One thread a process: with more, sums are ordered otherwise and last digits move. To be set
    # before NumPy is imported; worker processes inherit it.
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    from wam_power_ros.experiments import reproduce, studies

    folder = options.folder or Path("reproduction-quick" if options.quick else "reproduction")
    signal.signal(signal.SIGTERM, _interrupt)
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
        print(f"\nStopped. What is finished is in {folder}. To go on:\n  wam-power {again}")
        return 130
    except studies.JobError as error:
        print(f"wam-power: {error}What is finished is in {folder}.", file=sys.stderr)
        return 1
    print(f"Report: {_shown(report.resolve())}")
    return 0


def _tell(options: argparse.Namespace) -> int:
    if (options.word == "demonstration") != (options.bag is not None):
        raise UsageError("a demonstration, and only that, needs a bag")
    domain = _session_folder(options) / "logs" / DOMAIN
    if domain.exists():
        os.environ |= {
            "ROS_DOMAIN_ID": domain.read_text().strip(),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }
    from wam_power_ros.tell import tell

    taken, answer = tell(options.word, options.bag)
    print(answer if taken else f"refused: {answer}")
    return 0 if taken else 2


def _report(options: argparse.Namespace) -> int:
    from wam_power_ros import report, session

    folder = options.session
    _, _, records = session.read(folder)
    if any(record.truth for record in records):
        _exhibit(folder)
    else:
        report.write(folder)
    print(f"Report: {_shown(folder.resolve() / 'report.html')}")
    return 0


def _replay(options: argparse.Namespace) -> int:
    from wam_power_ros import bags, replay

    arm = setups.setup(options.config, options.rehearse)["torque_controller"]
    replay.movement(*bags.read_demonstration(options.bag, arm["joint_names"]), options.speed)
    folder = (options.folder or REPLAYS / _now()).resolve()
    signal.signal(signal.SIGTERM, _interrupt)
    changes = {"demonstration_recorder": {"stem": "replay"}}
    with _bench(options, folder, 0, changes) as bench:
        names = bench.setup["torque_controller"]["joint_names"]
        command = [sys.executable, "-m", "wam_power_ros.replaying", "--ros-args"]
        command += _enclave("operator")
        for given in (
            f"bag:={json.dumps(str(options.bag.resolve()))}",
            f"speed:={options.speed}",
            f"joint_names:={json.dumps(list(names))}",
            f"person:={json.dumps(not _simulated(options))}",
        ):
            command += ["-p", given]
        replaying = bench.processes.start("replaying", command, talks=True)
        while True:
            try:
                return bench.processes.wait(replaying)
            except KeyboardInterrupt:  # it stops the arm first; only then may the others end
                replaying.process.send_signal(signal.SIGINT)


def _play(options: argparse.Namespace) -> None:
    from wam_power_ros import playing

    signal.signal(signal.SIGTERM, _interrupt)
    playing.play(options.bag, options.rate, options.topics, options.wait)


def _recover(options: argparse.Namespace) -> None:
    from wam_power_ros.recovery import recover

    for bag in options.bag:
        print(recover(bag))


def _exhibit(folder: Path) -> None:
    """Write the report of a simulated session, with a film if this machine can render one."""
    command = [sys.executable, "-m", "wam_power_ros.experiments.exhibit", str(folder)]
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


# Processes


@dataclass(frozen=True)
class _Bench:
    """The nodes of one set-up."""

    processes: Processes
    setup: setups.Setup
    file: Path  # that holds it

    def start(self, node: str, **parameters: object) -> Running:
        """Start a node with its part of the set-up, and some parameters over it."""
        command = [sys.executable, "-m", "wam_power_ros.cli", "run", node, "--ros-args"]
        command += ["--params-file", str(self.file)]
        command += _enclave(node)
        for name, value in parameters.items():
            command += ["-p", f"{node}:{name}:={value}"]
        return self.processes.start(node, command)


@contextmanager
def _bench(
    options: argparse.Namespace, folder: Path, seed: int, changes: setups.Setup | None = None
) -> Iterator[_Bench]:
    """Controller, recorder into `folder`, and stand-ins unless there is a real arm."""
    setup = setups.setup(options.config, options.rehearse)
    for node, values in (changes or {}).items():
        setup[node] |= values
    file = folder / "logs" / "parameters.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(setups.text(setup))
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **os.environ}
    with ExitStack() as leave:
        if _simulated(options):
            environment["ROS_DOMAIN_ID"] = str(leave.enter_context(private_domain()))
            (folder / "logs" / DOMAIN).write_text(environment["ROS_DOMAIN_ID"] + "\n")
        else:
            (folder / "logs" / DOMAIN).unlink(missing_ok=True)
            _consent()
        processes = leave.enter_context(Processes(folder / "logs", environment))
        bench = _Bench(processes, setup, file)
        if _simulated(options):
            bench.start("wam_sim", seed=seed)
        bench.start("torque_controller")
        bench.start("demonstration_recorder", directory=folder / "bags")
        yield bench


def _enclave(name: str) -> list[str]:
    """Options that put a node into its enclave, where security is on."""
    secure = os.environ.get("ROS_SECURITY_ENABLE") == "true"
    return ["--enclave", f"/{name}"] if secure else []


def _simulated(options: argparse.Namespace) -> bool:
    return options.rehearse or not options.config


def _chosen(options: argparse.Namespace) -> list[str]:
    """The options that choose the same set-up again."""
    again = [word for name in options.config for word in ("--config", name)]
    return [*again, "--rehearse"] if options.rehearse else again


def _consent() -> None:
    """Nobody steps through a life cycle here: the controller holds the arm once states come."""
    print(
        "The controller takes hold of the arm where it is as soon as its driver sends states. "
        "Hand on the pendant, then press Enter: ",
        end="",
        file=sys.stderr,
        flush=True,
    )
    if not sys.stdin.readline():
        raise UsageError("nobody is at the keyboard: standard input is closed")


def _teach_series(bench: _Bench, folder: Path, options: argparse.Namespace) -> list[Path]:
    """Bags of the series taught in this folder, which is taught now if it was not yet."""
    series = folder / "demonstrations.json"
    person = not _simulated(options)
    if not series.exists():
        hand = "a person" if person else "the simulated hand"
        print(f"Teaching: {options.demonstrations} demonstrations, by {hand}")
        command = [sys.executable, "-m", "wam_power_ros.teaching", "--ros-args"]
        command += _enclave("operator")
        command += ["-p", f"demonstrations:={options.demonstrations}"]
        command += ["-p", f"series:={series}", "-p", f"person:={json.dumps(person)}"]
        command += ["-p", f"state_topic:={bench.setup['torque_controller']['state_topic']}"]
        bench.processes.finish(bench.processes.start("teaching", command, talks=True))
    return [Path(bag) for bag in json.loads(series.read_text())]


def _follow(folder: Path, processes: Processes, learner: Running) -> Sequence[Record]:
    """Show the session until the learner has ended it; returns its records."""
    from wam_power_ros import live, session
    from wam_power_ros.records import with_ratings

    path = folder / "rollouts.jsonl"
    log: Sequence[Line] = ()
    seen = 0
    over = False
    with live.Display() as display:
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


# Folders


def _session_folder(options: argparse.Namespace) -> Path:
    from wam_power_ros.session import Session, read

    folder = options.session
    if folder is None and options.resume:
        begun = [path for path in SESSIONS.glob("*") if Session.exists(path)]
        if not begun:
            raise UsageError(f"no session in {SESSIONS.resolve()} to go on with; name --session")
        folder = max(begun, key=lambda path: (path / "session.yaml").stat().st_mtime)
    if folder is None:
        folder = SESSIONS / f"{_now()}-seed-{options.seed or 0}"
    if options.resume and not Session.exists(folder):
        raise UsageError(f"{folder} holds no session to go on with")
    if Session.exists(folder):
        header, _, _ = read(folder)
        if options.seed is not None and options.seed != header.seed:
            raise UsageError(f"{folder} was begun with seed {header.seed}; leave --seed out")
        if options.preset or options.trials or options.bags:
            raise UsageError(f"{folder} was begun already; leave --preset, --trials and --bags out")
    return folder.resolve()


def _now() -> str:
    return datetime.now().strftime("%Y-%m-%d-%H%M%S")


def _shown(path: Path) -> Path:
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
