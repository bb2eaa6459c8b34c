# SPDX-License-Identifier: Apache-2.0
"""Text to and from the person at the terminal, without ROS."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Mapping


def show(text: str) -> None:
    """Print a line without delay, also where the output is a file."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def ask(text: str) -> bool:
    """Print a question and wait for Enter; False where standard input is closed."""
    sys.stderr.write(text)
    sys.stderr.flush()
    return bool(sys.stdin.readline())


def choose(otherwise: str, keys: Mapping[str, str]) -> str:
    """Ask for a key and Enter, or Enter alone.

    Args:
        otherwise: Answer returned for Enter alone, and where standard input is closed.
        keys: Key -> what it stands for.
    """
    listed = ", ".join(f"{key}: {word}" for key, word in keys.items())
    while True:
        sys.stderr.write(f"Enter: {otherwise}, {listed} > ")
        sys.stderr.flush()
        said = sys.stdin.readline().strip().lower()
        if not said:
            return otherwise
        if said in keys.values():
            return said
        if said in keys:
            return keys[said]


def cue(wanted: bool, word: str) -> None:
    """Ring the bell of the terminal, and say a word where a speech program is installed."""
    if not wanted:
        return
    sys.stderr.write("\a")
    sys.stderr.flush()
    if speaker := shutil.which("spd-say") or shutil.which("espeak"):
        quiet = subprocess.DEVNULL
        subprocess.Popen([speaker, word], stdin=quiet, stdout=quiet, stderr=quiet)
