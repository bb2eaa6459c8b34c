# SPDX-License-Identifier: Apache-2.0
"""Text to and from the person at the terminal, without ROS."""

from __future__ import annotations

import sys


def show(text: str) -> None:
    """Print a line without delay, also where the output is a file."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def ask(text: str) -> bool:
    """Print a question and wait for Enter; False where standard input is closed."""
    sys.stderr.write(text)
    sys.stderr.flush()
    return bool(sys.stdin.readline())
