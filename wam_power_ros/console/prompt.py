# SPDX-License-Identifier: Apache-2.0
"""Terminal output and input, without ROS."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager


def show(text: str) -> None:
    """Print a line and flush it, also if the output is a file."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def ask(text: str) -> bool:
    """Print a question and wait for Enter; returns False if standard input is closed."""
    sys.stderr.write(text)
    sys.stderr.flush()
    return bool(sys.stdin.readline())


def confirm(text: str) -> None:
    """Ask before the arm moves; a ValueError if standard input is closed."""
    if not ask(text):
        raise ValueError("no answer: standard input is closed")


@contextmanager
def let_go_after(person: bool) -> Iterator[None]:
    """Ask a person to support the arm, however the block ends: after it, no controller holds it."""
    try:
        yield
    finally:
        if person:
            ask("Support the arm, then press Enter to let it go: ")


def choose(default: str, keys: Mapping[str, str]) -> str:
    """Ask for a choice, by one of its keys, until a valid one is entered.

    Enter alone, or a closed standard input, is the default.
    """
    listed = ", ".join(f"{key}: {word}" for key, word in keys.items())
    while True:
        sys.stderr.write(f"Enter: {default}, {listed} > ")
        sys.stderr.flush()
        entered = sys.stdin.readline().strip().lower()
        if not entered:
            return default
        if entered in keys.values():
            return entered
        if entered in keys:
            return keys[entered]
