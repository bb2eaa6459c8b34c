# SPDX-License-Identifier: Apache-2.0
"""`wam-power`: the one command line. Starts nodes, follows a session, writes its report.

The nodes are processes of their own, the same that `ros2 run wam_power_ros NODE` starts; this one
opens no socket and imports no rclpy.
"""

from __future__ import annotations

import argparse
import importlib
import os
import shlex
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from wam_power_ros.cli import commands
from wam_power_ros.cli.launcher import UsageError, interrupt, shown
from wam_power_ros.cli.processes import ProcessError
from wam_power_ros.params import overlay

NODES = {  # executable -> module with a main(); setup.py has the same entry points
    "torque_controller": "wam_power_ros.nodes.torque_controller",
    "demonstration_recorder": "wam_power_ros.nodes.demonstration_recorder",
    "pancake_tracker": "wam_power_ros.nodes.pancake_tracker",
    "learner": "wam_power_ros.nodes.learner",
    "check_driver": "wam_power_ros.nodes.check_driver",
    "wam_sim": "hardware_sim.main",
    "optitrack_sim": "hardware_sim.optitrack_node",
}


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
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")

    learn = subparsers.add_parser(
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
    learn.set_defaults(command=commands.learn)

    teach = subparsers.add_parser(
        "teach", help="record demonstrations", description="Record demonstrations by hand."
    )
    teach.add_argument("--seed", type=_natural, help="of the stand-in (default 0)")
    teach.add_argument(
        "--task",
        choices=commands.TASKS,
        default="flip",
        help="what the simulated hand shows (flip)",
    )
    teach.add_argument("--folder", type=Path, help="for the bags (default: demonstrations/NOW)")
    _teaching_options(teach)
    teach.set_defaults(command=commands.teach)

    config = subparsers.add_parser(
        "config",
        help="print the parameters of every node under some set-ups",
        description="Print a parameter file for all nodes, as learn starts them with it; for "
        "ros2 run wam_power_ros NODE --ros-args --params-file FILE.",
    )
    config.add_argument(
        "config", nargs="*", metavar="NAME", help=f"of {', '.join(overlay.known())}"
    )
    config.add_argument("--simulate", action="store_true", help="with stand-ins for the devices")
    config.set_defaults(command=_config)

    policy = subparsers.add_parser(
        "policy",
        help="print the SROS2 policy of some set-ups",
        description="Print who may do what on the network, for ros2 security generate_artifacts.",
    )
    policy.add_argument("config", nargs="*", metavar="NAME", help="as for config")
    policy.set_defaults(command=_policy)

    tell = subparsers.add_parser(
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
    tell.set_defaults(command=commands.tell, **gone_on_with)

    report = subparsers.add_parser("report", help="write the report of a session")
    report.add_argument("session", type=Path, help="folder of the session")
    report.set_defaults(command=commands.report)

    replay = subparsers.add_parser(
        "replay",
        help="have the arm repeat a recorded movement, and say how well it did",
        description="The arm moves to the start of a bag and follows its joints; Ctrl-C stops it.",
    )
    replay.add_argument("bag", type=Path, help="a demonstration, or any bag with joint states")
    replay.add_argument("--speed", type=float, default=1.0, help="1 for as recorded (default)")
    replay.add_argument("--folder", type=Path, help="for its recording (default: replays/NOW)")
    _arm_options(replay)
    replay.set_defaults(command=commands.replay)

    play = subparsers.add_parser(
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

    recover = subparsers.add_parser(
        "recover", help="make a bag of what a kill, a full disk or a bad copy has left of one"
    )
    recover.add_argument("bag", type=Path, nargs="+", help="folder of the bag, or .mcap file")
    recover.set_defaults(command=_recover)

    enable = subparsers.add_parser(
        "enable",
        help="an enabling switch of the keyboard, for hold_to_run",
        description="Publish /controller/enable: true while a key of this terminal is held down.",
    )
    enable.set_defaults(command=_enable)

    reproduce = subparsers.add_parser(
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

    run = subparsers.add_parser(
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
        f"{', '.join(overlay.known())}, or a .yaml file; may be given again, the last one counts "
        "most. No stand-in is started",
    )
    parser.add_argument(
        "--simulate",
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
    print(overlay.text(overlay.setup(options.config, options.simulate)), end="")


def _policy(options: argparse.Namespace) -> None:
    from wam_power_ros.ros import security

    print(security.policy(security.table(overlay.setup(options.config))), end="")


def _enable(_: argparse.Namespace) -> int:
    return importlib.import_module("wam_power_ros.console.enabling_switch").main()


def _reproduce(options: argparse.Namespace) -> int:
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
        print(f"\nStopped. What is finished is in {folder}. To go on:\n  wam-power {again}")
        return 130
    except jobs.JobError as error:
        print(f"wam-power: {error}What is finished is in {folder}.", file=sys.stderr)
        return 1
    print(f"Report: {shown(report.resolve())}")
    return 0


def _play(options: argparse.Namespace) -> None:
    from wam_power_ros.console import play_bag

    signal.signal(signal.SIGTERM, interrupt)
    play_bag.play(options.bag, options.rate, options.topics, options.wait)


def _recover(options: argparse.Namespace) -> None:
    from wam_power_ros.bags.recovery import recover

    for bag in options.bag:
        print(recover(bag))


if __name__ == "__main__":
    sys.exit(main())
