# SPDX-License-Identifier: Apache-2.0
"""Replay a recorded movement on the arm and record it; Ctrl-C stops the arm.

The controller moves to the start, follows the movement at the given speed and holds. It checks the
limits and computes the tracking error.
"""

from __future__ import annotations

import shutil
from contextlib import nullcontext

import numpy as np

from wam_power_ros.client.robot import Robot, Stopped
from wam_power_ros.console.prompt import confirm, let_go_after, show
from wam_power_ros.control import replay_trajectory
from wam_power_ros.entry import INTERRUPTED
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError

NO_MOTION_CODES = (Code.REFUSED, Code.TOO_FAST, Code.NOT_ACTIVE, Code.BUSY, Code.NOTHING)
SETTLE_TIME = 1.0  # [s of wall time] recorded after a stop, while the arm comes to rest


def replay(
    robot: Robot,
    name: str,
    t: np.ndarray,
    q: np.ndarray,
    speed: float,
    person: bool,
    running: bool = False,
    warning: str = "",
) -> int:
    """Replay a movement of times t (N,) [s] and angles q (N, n) [rad]; returns the exit status.

    Args:
        speed: Speed relative to the recording, for messages.
        person: A person is beside a real arm, and asked before it moves, after a `warning`.
        running: Whether the nodes go on afterwards: nothing is recorded, and the arm is held.

    Raises:
        ServiceError: A service does not appear, does not answer in time, or refuses.
        ValueError: The person cannot answer, because standard input is closed.
    """
    movement = f"{name} at {speed:g} times its speed, {t[-1]:.1f} s"
    robot.stop()  # succeeds once the controller is active
    with let_go_after(person and not running):
        if person:
            confirm(f"{warning}The arm will move to the start of {movement}. Press Enter: ")
        show(f"Replaying {movement}; Ctrl-C stops the arm")
        with nullcontext() if running else robot.record() as bag:
            try:
                answer = Answer(Code.DONE, robot.follow(t, q))
            except Stopped as stopped:
                answer = stopped.answer or Answer(Code.STOPPED, "stopped")
                robot.link.sleep(SETTLE_TIME)
            except ServiceError as error:
                answer = error.answer or Answer(Code.UNKNOWN, str(error))
        show(with_possible_speed(answer, speed))
        moved = answer.code not in NO_MOTION_CODES
        if bag and moved:
            show(f"recorded: {bag}")
        elif bag:
            shutil.rmtree(bag)
        if not moved:
            show("The arm has not moved; nothing was recorded.")
        if answer.code is Code.STOPPED:
            show("Stopped: the arm holds.")
    if answer.success:
        return 0
    return INTERRUPTED if answer.code is Code.STOPPED else 1


def with_possible_speed(answer: Answer, speed: float) -> str:
    """Text of the controller's answer, with the highest possible --speed, if any, if too fast."""
    if answer.code is not Code.TOO_FAST:
        return answer.text
    possible = answer.speed * speed
    if possible < replay_trajectory.SPEED_MIN:
        return f"{answer.text}; no --speed is slow enough"
    return f"{answer.text}; possible at --speed {possible:.2f}"
