# SPDX-License-Identifier: Apache-2.0
"""Options that commands share."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

from wam_power_ros import installed
from wam_power_ros.cli.session_options import DEFAULT_TASK


def _at_least(minimum: int, text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if value < minimum:
        raise argparse.ArgumentTypeError(f"{value} must be at least {minimum}")
    return value


natural, positive = partial(_at_least, 0), partial(_at_least, 1)


def add_command(
    subparsers: argparse._SubParsersAction,
    name: str,
    command: Callable[..., int | None] | None,
    summary: str,
    description: str = "",
) -> argparse.ArgumentParser:
    """Add a command, a function whose arguments are its options, or None for a group of commands.

    Its description is the sentence above its options, if omitted its summary.
    """
    description = description or f"{summary[:1].upper()}{summary[1:]}."
    added = subparsers.add_parser(name, help=summary, description=description, allow_abbrev=False)
    added.set_defaults(command=command or added.print_help)
    return added


def config_option(parser: argparse.ArgumentParser, text: str) -> None:
    """Add the option `--config`."""
    parser.add_argument("--config", action="append", default=[], metavar="NAME", help=text)


def arm_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `Devices`."""
    config_option(
        parser,
        "set-up of a driver, a motion capture, ... (`wam-power list set-ups`), or a .yaml file; "
        "may be repeated, later ones override earlier ones. Starts no stand-ins",
    )
    text = "with --config: replace the devices by stand-ins with the same interfaces"
    parser.add_argument("--simulate", action="store_true", help=text)


def goal_value(text: str) -> tuple[str, float]:
    """Name and value of `NAME=VALUE`."""
    name, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not name or not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=NUMBER")
    return name, number


def task_option(parser: argparse.ArgumentParser, default: str = DEFAULT_TASK) -> None:
    """Add the option `--task`, whose value is imported if it is a class."""
    text = f"one of {', '.join(installed.names('task'))}, or a class, module:Class or file.py:Class"
    parser.add_argument("--task", type=_task, metavar="NAME", help=f"{text} (default: {default})")


def _task(text: str) -> str:
    try:
        return installed.import_task(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def demonstrations_option(parser: argparse.ArgumentParser) -> None:
    """Add the option `--demonstrations`."""
    text = "number to record (default 3)"
    parser.add_argument("--demonstrations", type=positive, default=3, help=text)


def seed_option(parser: argparse.ArgumentParser) -> None:
    """Add the option `--seed`."""
    parser.add_argument("--seed", type=natural, help="of exploration and simulation (default 0)")


def session_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `SessionOptions`, except the number of demonstrations."""
    task_option(parser)
    seed_option(parser)
    learners = f"one of {', '.join(installed.names('learner'))} (default: the preset's)"
    parser.add_argument("--learner", metavar="NAME", default="", help=learners)
    preset = "settings of the task (default: its first)"
    parser.add_argument("--preset", metavar="NAME", default="", help=preset)
    trials = "at most so many rollouts, before the re-tests (default: the preset's)"
    parser.add_argument("--trials", type=positive, help=trials)
    minutes = "at most so long, before the re-tests (default: no limit)"
    parser.add_argument("--minutes", type=positive, help=minutes)
    bags = "learn from these demonstrations, record none"
    parser.add_argument("--bags", type=Path, nargs="+", default=(), help=bags)
    origin = "begin with the policy of this session, such as one in simulation; record none"
    parser.add_argument("--from", type=Path, dest="origin", metavar="SESSION", help=origin)
    goal = "with --from: another goal (y=0.3 of reach); begin with the policy predicted for it"
    parser.add_argument("--goal", type=goal_value, nargs="+", default=(), metavar="N=V", help=goal)
