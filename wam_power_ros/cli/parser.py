# SPDX-License-Identifier: Apache-2.0
"""Argument parser that suggests the nearest valid name for a misspelt one; argument types."""

from __future__ import annotations

import argparse
import difflib
from collections.abc import Iterable, Sequence
from typing import Any


class Parser(argparse.ArgumentParser):
    """An `ArgumentParser` whose errors suggest the nearest valid name."""

    def _check_value(self, action: argparse.Action, value: Any) -> None:  # noqa: ANN401
        """Refuse a value that is not a choice; argparse calls this for every value."""
        if action.choices is not None and value not in action.choices:
            known = ", ".join(map(str, action.choices))
            hint = did_you_mean(str(value), map(str, action.choices))
            raise argparse.ArgumentError(action, f"{value!r} is not one of {known}{hint}")

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse; each subcommand refuses its own unknown options, whose nearest names it knows."""
        found, rest = super().parse_known_args(args, namespace)
        if unknown := [word for word in rest if word.startswith("-")]:
            options = [name for action in self._actions for name in action.option_strings]
            hints = [f"{word}{did_you_mean(word.partition('=')[0], options)}" for word in unknown]
            self.error(f"unknown option {', '.join(hints)}")
        return found, rest


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a question that suggests the nearest known word; empty if none is near."""
    near = difflib.get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def natural(text: str) -> int:
    """Parse a whole number of at least 0."""
    return _at_least(0, text)


def positive(text: str) -> int:
    """Parse a whole number of at least 1."""
    return _at_least(1, text)


def _at_least(minimum: int, text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if value < minimum:
        raise argparse.ArgumentTypeError(f"{value} must be at least {minimum}")
    return value
