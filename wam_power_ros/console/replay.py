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
import signal
import time
from pathlib import Path

from pydantic import Field
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from wam_power_ros.arm_identity import from_json
from wam_power_ros.bags import reader
from wam_power_ros.console.prompt import ask, show
from wam_power_ros.control import replay_trajectory
from wam_power_ros.params.node_params import Params
from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.ros.answers import Answer, Code
from wam_power_ros.ros.node_runner import run_script
from wam_power_ros.ros.service_client import LOG_AFTER, ServiceClient, ServiceError

STOPPED_STATUS = 130  # exit status
NO_MOTION_CODES = (
    Code.REFUSED,
    Code.TOO_FAST,
    Code.NOT_ACTIVE,
    Code.BUSY,
    Code.NOTHING,
)
RETRY_CODES = (Code.NOTHING, Code.BUSY)  # the movement was not received, or not read, yet
RECEIPT_TIMEOUT = 15.0  # [s of wall time] in which the controller must have read the movement
REPLAY_TIMEOUT = 3600.0  # [s of wall time]
SETTLE_TIME = 1.0  # [s of wall time] recorded after a stop, while the arm comes to rest


class ReplayParams(Params):
    """Parameters of a replay.

    Attributes:
        bag: Path of the bag.
        speed: Speed relative to the recording.
        joint_names: Joint names of the driver.
        arm: Identity of the arm as JSON text; "" if unknown.
        person: True to ask the person beside a real arm before it moves.
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


class Replay(Node):
    """Sends a movement to the controller and waits until it has ended."""

    def __init__(self) -> None:
        super().__init__("replaying", automatically_declare_parameters_from_overrides=True)
        self._params = params = ReplayParams.of(self)
        names = params.joint_names
        t, q = replay_trajectory.movement(
            *reader.read_demonstration(params.bag, names, arm=from_json(params.arm)), params.speed
        )
        self._duration = float(t[-1])
        self._message = joint_messages.movement_message(names, joint_messages.JointMovement(t, q))
        self._movements = self.create_publisher(
            JointTrajectory, interface.REPLAY_TRAJECTORY, interface.LATCHED
        )
        self._calls = ServiceClient(self, log_period=LOG_AFTER)
        self._signals: list[int] = []
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda received, _: self._signals.append(received))

    def run(self) -> int:
        """Replay once; returns the exit status.

        Raises:
            ServiceError: A service does not appear, does not answer in time, or refuses.
        """
        calls, name = self._calls, Path(self._params.bag).name
        calls.insist(Trigger, interface.STOP)  # succeeds once the controller is active
        self._movements.publish(self._message)
        movement = f"{name} at {self._params.speed:g} times its speed, {self._duration:.1f} s"
        self._ask(f"The arm will move to the start of {movement}. Press Enter: ")
        if self._signals:
            return STOPPED_STATUS
        show(f"Replaying {movement}; Ctrl-C stops the arm")
        calls.insist(SetBool, interface.RECORD, SetBool.Request(data=True))
        try:
            answer = self._follow()
        finally:
            path = calls.insist(SetBool, interface.RECORD, SetBool.Request(data=False)).text
        show(with_possible_speed(answer, self._params.speed))
        if answer.code in NO_MOTION_CODES:
            shutil.rmtree(path)
            show("The arm has not moved; nothing was recorded.")
        else:
            show(f"recorded: {path}")
        if self._signals:
            show("Stopped: the arm holds.")
        self._signals.clear()
        self._ask("The arm holds. Support it, then press Enter to let it go: ")
        if answer.success:
            return 0
        return STOPPED_STATUS if answer.code is Code.STOPPED else 1

    def _follow(self) -> Answer:
        """Answer of the controller once the movement has ended or was stopped."""
        calls = self._calls
        late = time.monotonic() + RECEIPT_TIMEOUT
        while True:
            future = calls.begin(Trigger, interface.REPLAY)
            ended = lambda f=future: f.done() or self._signals  # noqa: E731
            calls.until(ended, "the end of the replay", REPLAY_TIMEOUT)
            if not future.done():
                self._stop(future)
            answer = calls.answer(future)
            if self._signals or answer.code not in RETRY_CODES or time.monotonic() > late:
                return answer
            calls.until(lambda: False, timeout=0.05)

    def _stop(self, future: Future) -> None:
        self._calls.insist(Trigger, interface.STOP)
        if not self._calls.until(future.done, "the end of the replay"):
            raise ServiceError(f"{interface.REPLAY} did not answer after {interface.STOP}")
        self._calls.until(lambda: False, timeout=SETTLE_TIME)

    def _ask(self, text: str) -> None:
        if self._params.person and not self._signals:
            ask(text)


def with_possible_speed(answer: Answer, speed: float) -> str:
    """Text of the controller's answer, with the highest possible --speed, if any, if too fast.

    Args:
        answer: Answer of the controller.
        speed: Value of --speed for the refused movement.
    """
    if answer.code is not Code.TOO_FAST:
        return answer.text
    possible = float(answer.values["speed"]) * speed
    if possible < replay_trajectory.SPEED_MIN:
        return f"{answer.text}; no --speed is slow enough"
    return f"{answer.text}; possible at --speed {possible:.2f}"


def main() -> int:
    """Run `python -m wam_power_ros.console.replay`."""
    return run_script(Replay, Replay.run, signals=SignalHandlerOptions.NO)
