# SPDX-License-Identifier: Apache-2.0
"""Replay a recorded movement on the arm and record it; Ctrl-C stops the arm.

The controller moves to the start, follows the movement at the given speed and holds. It checks the
limits and computes the tracking error.
"""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports, which a signal may interrupt
    from wam_power_ros.entry import INTERRUPTED, start

    raise SystemExit(start("wam_power_ros.console.replay", INTERRUPTED))

import shutil
from contextlib import nullcontext
from pathlib import Path

from pydantic import Field
from rclpy.node import Node

from wam_power_ros.arm_identity import from_json
from wam_power_ros.bags import reader
from wam_power_ros.client.link import LOG_AFTER, Link
from wam_power_ros.client.robot import Robot, Stopped
from wam_power_ros.console.prompt import ask, show
from wam_power_ros.control import replay_trajectory
from wam_power_ros.entry import INTERRUPTED
from wam_power_ros.params.node_params import Params
from wam_power_ros.ros.node_runner import run_script
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError

NO_MOTION_CODES = (
    Code.REFUSED,
    Code.TOO_FAST,
    Code.NOT_ACTIVE,
    Code.BUSY,
    Code.NOTHING,
)
SETTLE_TIME = 1.0  # [s of wall time] recorded after a stop, while the arm comes to rest


class ReplayParams(Params):
    """Parameters of a replay.

    Attributes:
        bag: Path of the bag.
        speed: Speed relative to the recording.
        joint_names: Joint names of the driver.
        arm: Identity of the arm as JSON text; "" if unknown.
        person: True to ask the person beside a real arm before it moves.
        running: True if the nodes go on afterwards: nothing is recorded, and the arm is held.
    """

    bag: str
    speed: float = Field(
        ge=replay_trajectory.SPEED_MIN,
        le=replay_trajectory.SPEED_MAX,
        description="slower takes too long; faster exceeds the speed limits of the joints",
    )
    joint_names: tuple[str, ...] = Field(min_length=1, max_length=16)
    arm: str
    person: bool
    running: bool


class Replaying(Node):
    """Node of the script, with its parameters."""

    def __init__(self) -> None:
        super().__init__("replaying", automatically_declare_parameters_from_overrides=True)
        self.params = ReplayParams.of(self)


def replay(link: Link, params: ReplayParams) -> int:
    """Replay once; returns the exit status.

    Raises:
        ValueError: The bag is not acceptable.
        ServiceError: A service does not appear, does not answer in time, or refuses.
    """
    recorded = reader.read_demonstration(params.bag, params.joint_names, arm=from_json(params.arm))
    t, q = replay_trajectory.movement(*recorded, params.speed)
    movement = f"{Path(params.bag).name} at {params.speed:g} times its speed, {t[-1]:.1f} s"
    robot = Robot(link, joint_names=params.joint_names)
    robot.stop()  # succeeds once the controller is active
    if params.person:
        ask(f"The arm will move to the start of {movement}. Press Enter: ")
    show(f"Replaying {movement}; Ctrl-C stops the arm")
    with nullcontext() if params.running else robot.record() as bag:
        try:
            answer = Answer(Code.DONE, robot.follow(t, q))
        except Stopped as stopped:
            answer = stopped.answer or Answer(Code.STOPPED, "stopped")
            link.sleep(SETTLE_TIME)
        except ServiceError as error:
            answer = error.answer or Answer(Code.UNKNOWN, str(error))
    show(with_possible_speed(answer, params.speed))
    moved = answer.code not in NO_MOTION_CODES
    if bag and moved:
        show(f"recorded: {bag}")
    elif bag:
        shutil.rmtree(bag)
    if not moved:
        show("The arm has not moved; nothing was recorded.")
    if answer.code is Code.STOPPED:
        show("Stopped: the arm holds.")
    if params.person and not params.running:
        ask("The arm holds. Support it, then press Enter to let it go: ")
    if answer.success:
        return 0
    return INTERRUPTED if answer.code is Code.STOPPED else 1


def with_possible_speed(answer: Answer, speed: float) -> str:
    """Text of the controller's answer, with the highest possible --speed, if any, if too fast.

    Args:
        answer: Answer of the controller.
        speed: Value of --speed for the refused movement.
    """
    if answer.code is not Code.TOO_FAST:
        return answer.text
    possible = answer.speed * speed
    if possible < replay_trajectory.SPEED_MIN:
        return f"{answer.text}; no --speed is slow enough"
    return f"{answer.text}; possible at --speed {possible:.2f}"


def main() -> int:
    """Run `python -m wam_power_ros.console.replay`."""

    def work(node: Replaying) -> int:
        with Link(node, log_period=LOG_AFTER) as link:
            return replay(link, node.params)

    return run_script(Replaying, work)
