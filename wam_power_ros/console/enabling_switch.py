# SPDX-License-Identifier: Apache-2.0
"""Keyboard as enabling switch: /controller/enable is true while a key is held down.

A stop-gap until a real switch publishes there. A terminal does not report that a key is released,
only that it repeats, so the release is noticed up to `FIRST_REPEAT` after the key was pressed and
up to `NEXT_REPEAT` later on. It is no safety function.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty

import rclpy
from std_msgs.msg import Bool

from wam_power_ros.console.prompt import show
from wam_power_ros.ros import interface
from wam_power_ros.ros.node_runner import participant

FIRST_REPEAT = 0.75  # [s] within which a held key repeats for the first time
NEXT_REPEAT = 0.15  # [s] within which it repeats again
PERIOD = 0.02  # [s] between two publications of the switch


class HeldKey:
    """Whether a key is held down, deduced from its repetitions; times are passed in [s]."""

    def __init__(self) -> None:
        self._until = -1.0

    def press(self, now: float) -> None:
        """The terminal has sent the key at time `now` [s]."""
        self._until = now + (NEXT_REPEAT if self.held(now) else FIRST_REPEAT)

    def held(self, now: float) -> bool:
        """Whether the key counts as held at time `now` [s]."""
        return now < self._until


def main() -> int:
    """Body of `wam-power enable`: publish until Ctrl-C or until the terminal is closed."""
    if not sys.stdin.isatty():
        raise ValueError("enable needs a terminal: its keys are the switch")
    with participant(lambda: rclpy.create_node("enabling_switch")) as node:
        switch = node.create_publisher(Bool, interface.ENABLE, interface.ENABLE_OUT)
        key, terminal = HeldKey(), sys.stdin.fileno()
        before = termios.tcgetattr(terminal)
        show("Hold any key down to enable the arm; Ctrl-C ends.")
        try:
            tty.setcbreak(terminal)
            while rclpy.ok():
                if select.select([terminal], [], [], PERIOD)[0]:
                    if not os.read(terminal, 1024):
                        break
                    key.press(time.monotonic())
                switch.publish(Bool(data=key.held(time.monotonic())))
        except KeyboardInterrupt:
            pass
        finally:
            termios.tcsetattr(terminal, termios.TCSADRAIN, before)
            if rclpy.ok():
                switch.publish(Bool(data=False))
    return 0
