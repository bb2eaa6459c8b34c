# SPDX-License-Identifier: Apache-2.0
"""Argument parser that suggests the nearest valid name for a misspelt one; options of commands."""

from __future__ import annotations

import argparse
import math
import shutil
import textwrap
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from wam_power_ros import installed
from wam_power_ros.cli.session_options import DEFAULT_TASK


class Parser(argparse.ArgumentParser):
    """An `ArgumentParser` whose errors suggest the nearest valid name; options are written out.

    Attributes:
        summary: What a command does, for the list of commands.
    """

    summary = ""

    def __init__(self, **given: Any) -> None:  # noqa: ANN401 - of any kind
        super().__init__(**given, allow_abbrev=False)

    def list_commands(
        self, commands: Mapping[str, Parser], headings: Mapping[str, Sequence[str]]
    ) -> None:
        """Let the help end with the commands, under their headings."""
        width = max(shutil.get_terminal_size().columns - 2, 40)
        lines = []
        for heading, names in headings.items():
            lines.append(f"\n{heading}:")
            for name in names:
                text = f"  {name:12}{commands[name].summary}"
                lines += textwrap.wrap(text, width, subsequent_indent=14 * " ")
        self.epilog = "\n".join(lines).lstrip()

    def _check_value(self, action: argparse.Action, value: Any) -> None:  # noqa: ANN401
        """Refuse a value that is not a choice; argparse calls this for every value."""
        if action.choices is not None and value not in action.choices:
            known = ", ".join(map(str, action.choices))
            hint = installed.did_you_mean(str(value), map(str, action.choices))
            raise argparse.ArgumentError(action, f"{value!r} is not one of {known}{hint}")

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse; each subcommand refuses its own unknown options, whose nearest names it knows."""
        found, rest = super().parse_known_args(args, namespace)
        if unknown := [word for word in rest if word.startswith("-")]:
            options = [name for action in self._actions for name in action.option_strings]
            meant = partial(installed.did_you_mean, known=options)
            hints = [f"{word}{meant(word.partition('=')[0])}" for word in unknown]
            self.error(f"unknown option {', '.join(hints)}")
        return found, rest


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
    description = description or f"{summary.capitalize()}."
    added: Parser = subparsers.add_parser(name, help=summary, description=description)
    added.summary = summary
    if command is not None:
        added.set_defaults(command=command)
    return added


def config_option(parser: argparse.ArgumentParser, text: str) -> None:
    """Add the option `--config`."""
    parser.add_argument("--config", action="append", default=[], metavar="NAME", help=text)


def preset_option(parser: argparse.ArgumentParser) -> None:
    """Add the option `--preset`."""
    text = "settings of the task (default: its first)"
    parser.add_argument("--preset", metavar="NAME", default="", help=text)


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


def seed_option(parser: argparse.ArgumentParser) -> None:
    """Add the option `--seed`."""
    parser.add_argument("--seed", type=natural, help="of exploration and simulation (default 0)")


def session_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `SessionOptions`, except the number of demonstrations."""
    task_option(parser)
    seed_option(parser)
    learners = f"one of {', '.join(installed.names('learner'))} (default: the preset's)"
    parser.add_argument("--learner", metavar="NAME", default="", help=learners)
    preset_option(parser)
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
