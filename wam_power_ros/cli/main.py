# SPDX-License-Identifier: Apache-2.0
"""The command line `wam-power`: parses the options and runs one command.

Nodes run as processes of their own, the same that `ros2 run wam_power_ros NODE` starts; this
process opens no socket and imports no rclpy before a command needs it.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import shutil
import signal
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

from wam_power_ros import __version__, installed
from wam_power_ros.cli import bags_command, commands
from wam_power_ros.cli.launcher import Devices, UsageError
from wam_power_ros.cli.parser import (
    add_command,
    arm_options,
    demonstrations_option,
    natural,
    positive,
    seed_option,
    session_options,
    task_option,
)
from wam_power_ros.cli.processes import ProcessError
from wam_power_ros.cli.session_options import SESSIONS, SessionOptions
from wam_power_ros.durable_files import explained
from wam_power_ros.entry import INTERRUPTED, missing
from wam_power_ros.params import overlay

COMMAND_LINE = "wam-power"
NODES = {  # executable of `ros2 run` -> entry point, as setup.py declares them
    entry.name: entry for entry in metadata.entry_points(group="wam_power_ros.nodes")
}

HEADINGS = {
    "First": ("learn", "teach", "replay", "view", "doctor"),
    "Session": ("sessions", "feedback", "stop", "report", "run-policy"),
    "Arm": ("new-arm", "commission", "enable"),
    "Recordings": ("bags", "recover"),
    "Names, set-ups, nodes": ("list", "config", "run"),
}
LISTED = ("tasks", "learners", "presets", "set-ups")
OUTPUTS = ("torque", "position", "trajectory", "pose")


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `wam-power`; returns the exit status."""
    _replace_unencodable_characters()
    parser = _parser()
    with contextlib.suppress(ImportError):  # the extra "completion"
        import argcomplete

        argcomplete.autocomplete(parser)
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # acts as Ctrl-C does
    try:
        command, values = _command(options)
        return int(command(**values) or 0)
    except ImportError as error:
        print(f"{COMMAND_LINE}: {missing(error)}", file=sys.stderr)
        return 2
    except (UsageError, ProcessError, OSError, ValueError) as error:
        text = explained(error) if isinstance(error, OSError) else str(error)
        print(f"{COMMAND_LINE}: {text}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return INTERRUPTED


def _command(options: argparse.Namespace) -> tuple[Callable[..., int | None], dict[str, Any]]:
    """Command of parsed options, and its arguments by name.

    Options that belong together are one argument.
    """
    values = dict(vars(options))
    command = values.pop("command")
    for name, kind in (("asked", SessionOptions), ("devices", Devices)):
        own = {field.name for field in fields(kind)}
        if own <= values.keys():
            values[name] = kind(**{key: values.pop(key) for key in own})
    devices = values.get("devices", Devices())
    if devices.simulate and not devices.config:
        raise UsageError(
            "--simulate replaces the devices of --config NAME by stand-ins; without --config "
            "everything is simulated already"
        )
    return command, values


def _replace_unencodable_characters() -> None:
    """Print "?" for characters that the terminal cannot encode, here and in child processes."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    encoding = os.environ.get("PYTHONIOENCODING", "").partition(":")[0]
    os.environ["PYTHONIOENCODING"] = f"{encoding}:replace"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=COMMAND_LINE,
        usage=f"{COMMAND_LINE} [-h] [--version] COMMAND ...",
        description="Teach a robot arm by hand; let it improve by practising.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"wam_power_ros {__version__}")
    parser.set_defaults(command=parser.print_help)
    subparsers = parser.add_subparsers(metavar="COMMAND", prog=COMMAND_LINE, help=argparse.SUPPRESS)

    add = partial(add_command, subparsers)
    learn = add("learn", commands.learn, "teach and learn; or resume a session")
    demonstrations_option(learn)
    session_options(learn)
    learn.add_argument("--session", type=Path, help="folder; resumed if it holds a session")
    in_process = "simulate arm, controller and cameras in this process: without ROS, and faster"
    learn.add_argument("--in-process", action="store_true", help=in_process)
    arm_options(learn)

    teach = add("teach", commands.teach, "record kinesthetic demonstrations")
    demonstrations_option(teach)
    task_option(teach)
    seed_option(teach)
    teach.add_argument("--folder", type=Path, help="for the bags (default: demonstrations/NOW)")
    arm_options(teach)

    replay = add("replay", commands.replay, "repeat a recorded movement; print the tracking error")
    replay.add_argument("bag", type=Path, help="a demonstration, or any bag with joint states")
    replay.add_argument("--speed", type=float, default=1.0, help="1: as recorded (default)")
    task_option(replay, "none")
    replay.add_argument("--folder", type=Path, help="for the recording (default: replays/NOW)")
    arm_options(replay)

    view = add("view", commands.view, "serve a page that shows a session in a browser")
    shown = "folder (default: newest session)"
    view.add_argument("path", type=Path, nargs="?", metavar="SESSION", help=shown)
    address = (
        "to serve the page at (default 127.0.0.1: this machine only). At any other address, "
        "everyone who can reach it can press the buttons"
    )
    view.add_argument("--address", default="127.0.0.1", help=address)
    port = "or the next free one (default 8080)"
    view.add_argument("--port", type=natural, default=8080, help=port)

    text = "say what is missing before the first demonstration; status 1 if something is"
    doctor = add("doctor", _later("cli.doctor_command", "doctor"), text)
    task_option(doctor, "none")
    arm_options(doctor)

    listing = add("sessions", commands.sessions, "list sessions")
    folders = f"a session, or a folder of sessions (default: {SESSIONS})"
    listing.add_argument("folder", type=Path, nargs="*", help=folders)
    feedback = add("feedback", commands.feedback, "rate the last rollout, or teach, in a session")
    kinds = (
        "rate: the rollout for whose rating the session waits (task rated); reward or punish: the "
        "last finished rollout; demonstration: learn from it if its reproduction is better; pause: "
        "stop after the current trial, e.g. to teach in between"
    )
    choices = ("rate", "reward", "punish", "demonstration", "pause", "continue")
    feedback.add_argument("kind", choices=choices, help=kinds)
    given = "bag of the demonstration; rating from 0 (worst) to 9 (as it should be)"
    feedback.add_argument("given", nargs="?", metavar="BAG|RATING", help=given)
    stop = add(
        "stop",
        partial(commands.feedback, kind="stop", given=None),
        "stop the arm and pause its session, until wam-power feedback continue; no safety function",
    )
    for each in (feedback, stop):
        each.add_argument("--session", type=Path, help="folder (default: the newest session)")
    report = add("report", commands.report, "write the report of a session")
    report.add_argument("session", type=Path, help="folder of the session")

    run_policy = add("run-policy", commands.run_policy, "execute a saved policy; print its return")
    run_policy.add_argument("policy", type=Path, help="policy.json, or the folder of a session")
    run_policy.add_argument("--rollouts", type=positive, default=1, help="number (default 1)")
    task_option(run_policy)
    run_policy.add_argument("--folder", type=Path, help="for the recordings (default: runs/NOW)")
    arm_options(run_policy)

    text = "propose the set-up of an arm from its URDF, with a reason for each value"
    new_arm = add("new-arm", _later("cli.new_arm_command", "new_arm"), text)
    new_arm.add_argument("urdf", type=Path, metavar="URDF", help="file, or xacro file")
    new_arm.add_argument("--tool", default="", metavar="LINK", help="link that is the tool")
    taken = "what the driver takes"
    new_arm.add_argument("--output", choices=OUTPUTS, default=OUTPUTS[0], help=taken)
    new_arm.add_argument("--file", type=Path, metavar="FILE", help="set-up to write")

    commission = add(
        "commission",
        _later("cli.commission_command", "commission"),
        "let the arm measure its zeros, friction, tool and cameras; writes a set-up file",
        "Move the arm for about four minutes, with markers fixed to its empty tool, and compare "
        "what encoders, torques and cameras say. An arm that takes positions needs no markers, and "
        "half a minute. Hardware: nobody within reach.",
    )
    mass = "of what the last joint carries [kg], weighed"
    commission.add_argument("--tool-mass", type=float, help=mass)
    flat = (
        "the tracked body lies flat in the tool, its z axis along the tool's: then the zero of the "
        "last joint is found, too"
    )
    commission.add_argument("--flat", action="store_true", help=flat)
    output = "set-up file (default: arm.yaml in the folder)"
    commission.add_argument("--output", type=Path, help=output)
    recorded = "of the recording; an existing one is analysed again"
    commission.add_argument("--folder", type=Path, help=recorded)
    arm_options(commission)

    switch = _later("console.enabling_switch", "main")
    add("enable", switch, "use the keyboard as the switch that hold_to_run requires")
    bags_command.add_to(subparsers)
    recover = add("recover", bags_command.recover, "recover bags damaged by a kill or a full disk")
    recover.add_argument("bag", type=Path, nargs="+", help="folder of the bag, or .mcap file")
    listing = add("list", _list, "print a line for each task, learner, preset or set-up")
    listing.add_argument("what", choices=LISTED)
    config = add("config", commands.config, "print the parameters of every node for set-ups")
    task_option(config)
    arm_options(config)
    run = add("run", _run, "start one node, as ros2 run wam_power_ros NODE --ros-args ... does")
    run.add_argument("node", choices=NODES)
    run.add_argument("rest", nargs=argparse.REMAINDER, metavar="...", help="arguments of the node")
    parser.epilog = _listed(subparsers.choices)
    return parser


def _later(module: str, name: str) -> Callable[..., int]:
    """A command whose module, slow to import or of ROS, is imported when it is run."""

    def command(**values: object) -> int:
        return getattr(import_module(f"wam_power_ros.{module}"), name)(**values)

    return command


def _listed(commands: Mapping[str, argparse.ArgumentParser]) -> str:
    """The commands with the first sentence of their descriptions, under `HEADINGS`."""
    width = max(shutil.get_terminal_size().columns - 2, 40)
    lines = []
    for heading, names in HEADINGS.items():
        lines.append(f"\n{heading}:")
        for name in names:
            sentence, _, _ = str(commands[name].description).partition(". ")
            text = f"  {name:12}{sentence.rstrip('.')}"
            lines += textwrap.wrap(text, width, subsequent_indent=14 * " ")
    return "\n".join(lines).lstrip()


def _list(what: str) -> None:
    """Print a line for each name of a kind, with what it is."""
    from wam_power_ros.practice.settings import preset

    tasks, kind = installed.names("task"), what.removesuffix("s")
    if what == "presets":
        pairs = [(task, name) for task in tasks for name in installed.task_type(task).presets]
        rows = {" ".join(pair): f"learner {preset(*pair).learner}" for pair in pairs}
    elif what == "set-ups":
        rows = {name: overlay.summary(name) for name in overlay.known() if name not in tasks}
    else:
        docs = {name: installed.find(kind, name).__doc__ for name in installed.names(kind)}
        rows = {name: (text or "").strip().partition("\n")[0] for name, text in docs.items()}
    width = max(map(len, rows))
    for name, text in rows.items():
        print(f"{name:{width}}  {text}")


def _run(node: str, rest: Sequence[str]) -> int:
    sys.argv = [node, *rest]
    return NODES[node].load()()
