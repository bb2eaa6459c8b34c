# SPDX-License-Identifier: Apache-2.0
"""Move the arm through the movement of its commissioning and record it; Ctrl-C stops the arm."""

from __future__ import annotations

import numpy as np

from wam_power_ros.client.robot import Robot, Stopped
from wam_power_ros.console.prompt import ask, let_go_after, show
from wam_power_ros.console.replay import SETTLE_TIME
from wam_power_ros.entry import INTERRUPTED
from wam_power_ros.ros.outcomes import ServiceError

LOG_PERIOD = 30.0  # [s] between two lines about the movement under way


def move(robot: Robot, t: np.ndarray, q: np.ndarray, person: bool) -> int:
    """Execute the movement once and record it; returns the exit status.

    Args:
        t: Times [s]. Shape (T,).
        q: Joint angles [rad]. Shape (T, n).
        person: Whether to ask the person beside a real arm before it moves.

    Raises:
        ServiceError: A service does not appear, does not answer in time, or refuses.
    """
    robot.link.log_period = LOG_PERIOD
    robot.stop()  # succeeds once the controller is active
    with let_go_after(person):
        if person:
            ask(
                f"The arm will move by itself for {t[-1] / 60:.1f} minutes, tool below 1.2 m/s. "
                "Nobody within reach, a hand on the pendant. Press Enter: "
            )
        robot.await_recorder()
        show(f"Moving for {t[-1]:.0f} s; Ctrl-C stops the arm")
        with robot.record():
            try:
                show(robot.follow(t, q).splitlines()[0])
            except Stopped:
                robot.link.sleep(SETTLE_TIME)
                show("Stopped: the arm holds.")
                return INTERRUPTED
            except ServiceError as error:
                show(str(error))
                return 1
    return 0
