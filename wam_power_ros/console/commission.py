# SPDX-License-Identifier: Apache-2.0
"""Move the arm through the movement of its commissioning and record it; Ctrl-C stops the arm."""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports, which a signal may interrupt
    from wam_power_ros.entry import INTERRUPTED, start

    raise SystemExit(start("wam_power_ros.console.commission", INTERRUPTED))

from pathlib import Path

import numpy as np
from pydantic import Field
from rclpy.node import Node

from wam_power_ros.client.link import Link
from wam_power_ros.client.robot import Robot, Stopped
from wam_power_ros.console.prompt import ask, show
from wam_power_ros.entry import INTERRUPTED
from wam_power_ros.params.node_params import Params
from wam_power_ros.ros.node_runner import run_script
from wam_power_ros.ros.outcomes import ServiceError

LOG_PERIOD = 30.0  # [s] between two lines about the movement under way
SETTLE_TIME = 1.0  # [s] recorded after a stop, while the arm comes to rest


class CommissionParams(Params):
    """Parameters of the movement.

    Attributes:
        movement: File of NumPy with `t` [s], shape (T,), and `q` [rad], shape (T, n).
        joint_names: Joint names of the driver.
        state_topic: Topic of the joint states, to which the recorder subscribes.
        person: True to ask the person beside a real arm before it moves.
    """

    movement: str
    joint_names: tuple[str, ...] = Field(min_length=1, max_length=16)
    state_topic: str
    person: bool


class Commissioning(Node):
    """Node of the script, with its parameters."""

    def __init__(self) -> None:
        super().__init__("commissioning", automatically_declare_parameters_from_overrides=True)
        self.params = CommissionParams.of(self)


def move(node: Commissioning) -> int:
    """Execute the movement once and record it; returns the exit status."""
    params = node.params
    with np.load(Path(params.movement)) as file:
        t, q = file["t"], file["q"]
    with Link(node, log_period=LOG_PERIOD) as link:
        robot = Robot(link, params.state_topic, joint_names=params.joint_names)
        robot.stop()  # succeeds once the controller is active
        if params.person:
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
                link.sleep(SETTLE_TIME)
                show("Stopped: the arm holds.")
                return INTERRUPTED
            except ServiceError as error:
                show(str(error))
                return 1
        if params.person:
            ask("The arm holds. Support it, then press Enter to let it go: ")
    return 0


def main() -> int:
    """Run `python -m wam_power_ros.console.commission`."""
    return run_script(Commissioning, move)
