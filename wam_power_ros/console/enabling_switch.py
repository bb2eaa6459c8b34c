# SPDX-License-Identifier: Apache-2.0
"""Keyboard as enabling switch: /controller/enable is true while a key is held down.

A substitute until a real switch publishes there. A terminal reports repetitions of a key but not
its release, so the release is detected up to `FIRST_REPEAT` after the key was pressed, later up to
`NEXT_REPEAT` after the last repetition. It is no safety function.
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
from wam_power_ros.ros.node_runner import interrupt_on_signals, participant

FIRST_REPEAT = 0.75  # [s] at most until a held key repeats for the first time
NEXT_REPEAT = 0.15  # [s] at most until it repeats again
PUBLISH_PERIOD = 0.02  # [s]


class HeldKey:
    """State of a key, derived from its repetitions."""

    def __init__(self) -> None:
        self._release_time = -1.0

    def press(self, now: float) -> None:
        """Register that the terminal sent the key at time `now` [s]."""
        self._release_time = now + (NEXT_REPEAT if self.held(now) else FIRST_REPEAT)

    def held(self, now: float) -> bool:
        """Whether the key counts as held at time `now` [s]."""
        return now < self._release_time


def main() -> int:
    """Run `wam-power enable`: publish until Ctrl-C or until the terminal is closed."""
    if not sys.stdin.isatty():
        raise ValueError("enable reads keys from a terminal, but standard input is not one")
    interrupt_on_signals()
    with participant(lambda: rclpy.create_node("enabling_switch")) as node:
        switch = node.create_publisher(Bool, interface.ENABLE, interface.COMMAND)
        key, terminal = HeldKey(), sys.stdin.fileno()
        before = termios.tcgetattr(terminal)
        show("Hold any key down to enable the arm; Ctrl-C ends.")
        try:
            tty.setcbreak(terminal)
            while True:
                if select.select([terminal], [], [], PUBLISH_PERIOD)[0]:
                    if not os.read(terminal, 1024):
                        break
                    key.press(time.monotonic())
                switch.publish(Bool(data=key.held(time.monotonic())))
        except KeyboardInterrupt:
            pass
        finally:
            termios.tcsetattr(terminal, termios.TCSADRAIN, before)
            switch.publish(Bool(data=False))
    return 0
