# SPDX-License-Identifier: Apache-2.0
"""An enabling switch made of a keyboard: /controller/enable is true while a key is held down.

A stop-gap until a real switch publishes there: a terminal does not tell when a key is released,
only that it repeats, so the release is noticed up to `FIRST` after the key was pressed, up to
`NEXT` later. No safety function, as nothing here is one.
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

from wam_power_ros.ros import interface
from wam_power_ros.ros.node_runner import number_by_process

FIRST, NEXT = 0.75, 0.15  # [s] in which a key that is held repeats for the first time, and again
PERIOD = 0.02  # [s] at which the state of the key is published


class HeldKey:
    """Whether a key is held down, told by its repeats; times are handed in [s]."""

    def __init__(self) -> None:
        self._until = -1.0

    def came(self, now: float) -> None:
        """The terminal has sent the key."""
        self._until = now + (NEXT if self.held(now) else FIRST)

    def held(self, now: float) -> bool:
        """Whether the key counts as held."""
        return now < self._until


def main() -> int:
    """Body of `wam-power enable`: publish until Ctrl-C, or until the terminal is gone."""
    if not sys.stdin.isatty():
        raise ValueError("enable needs a terminal, whose keys are the switch")
    rclpy.init()
    with number_by_process():
        node = rclpy.create_node("enabling_switch")
    switch = node.create_publisher(Bool, interface.ENABLE, interface.ENABLE_OUT)
    key, terminal = HeldKey(), sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    sys.stdout.write("Hold any key down to enable the arm; Ctrl-C ends.\n")
    try:
        tty.setcbreak(terminal)
        while rclpy.ok():
            if select.select([terminal], [], [], PERIOD)[0]:
                if not os.read(terminal, 1024):
                    break
                key.came(time.monotonic())
            switch.publish(Bool(data=key.held(time.monotonic())))
    except KeyboardInterrupt:
        pass
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
        if rclpy.ok():
            switch.publish(Bool(data=False))
        rclpy.try_shutdown()
    return 0
