# SPDX-License-Identifier: Apache-2.0
"""Record a series of kinesthetic demonstrations under gravity compensation.

The teacher is a person, who presses Enter, or the demonstrator of the stand-in. Every take is added
to the list of bags in a file at once. In a review after each take, a person may repeat or discard
it, or end the series.
"""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports, which a signal may interrupt
    from wam_power_ros.entry import INTERRUPTED, start

    raise SystemExit(start("wam_power_ros.console.teach", INTERRUPTED))

from pathlib import Path

from pydantic import Field
from rclpy.node import Node

from wam_power_ros.bags import series
from wam_power_ros.client.link import LOG_AFTER, Link
from wam_power_ros.client.robot import Robot
from wam_power_ros.console.prompt import ask, choose, cue, show
from wam_power_ros.params.node_params import Params
from wam_power_ros.ros.node_runner import run_script
from wam_power_ros.ros.outcomes import ServiceError

KEEP, AGAIN, DISCARD, DONE = "keep", "again", "discard", "done"
KEYS = {"a": AGAIN, "d": DISCARD, "q": DONE}


class TeachParams(Params):
    """Parameters of a series.

    Attributes:
        demonstrations: Number of demonstrations to record.
        series: File with the list of bags, to which new ones are added.
        person: True if a person guides the arm by hand, False for the demonstrator of the stand-in.
        review: True to ask a person after each take to keep, repeat or discard it.
        bell: True for a cue at begin and end of a recording, see `prompt.cue`.
        body: Name of the tracked body; "" for none.
        state_topic: Topic of the joint states, to which the recorder subscribes.
    """

    demonstrations: int = Field(ge=1, le=100, description="a person's patience")
    series: str
    person: bool
    review: bool
    bell: bool
    body: str
    state_topic: str


class Teaching(Node):
    """Node of the script, with its parameters."""

    def __init__(self) -> None:
        super().__init__("teaching", automatically_declare_parameters_from_overrides=True)
        self.params = TeachParams.of(self)


def record_series(node: Teaching) -> None:
    """Record the series; the arm holds its position afterwards.

    Raises:
        ServiceError: A service does not appear, does not answer in time, or refuses.
    """
    params = node.params
    with Link(node, log_period=LOG_AFTER) as link:
        robot = Robot(link, params.state_topic, body=params.body)
        with robot.guided():
            if not params.person:  # a person is slower than the start of any node
                robot.await_recorder()
            _record_takes(robot, params)


def _record_takes(robot: Robot, params: TeachParams) -> None:
    file = Path(params.series)
    bags, number, wanted = series.read(file), 1, params.demonstrations
    while number <= wanted:
        bag = _take(robot, params, number)
        bags.append(bag)
        series.write(file, bags)  # at once: kept even if interrupted
        show(f"  {number} of {wanted}: {bag}")
        choice = choose(KEEP, KEYS) if params.review else KEEP
        if choice in (AGAIN, DISCARD):
            bags.pop()
            show(f"  discarded; moved to {series.discard(bag)}")
        wanted = {DONE: number, DISCARD: wanted - 1}.get(choice, wanted)
        number += choice in (KEEP, DONE)


def _take(robot: Robot, params: TeachParams, number: int) -> Path:
    """Record one demonstration; returns the path of its bag."""
    if params.person:
        _ask(f"demonstration {number}: press Enter, then guide the arm by hand ")
    else:
        robot.put_back()
    with robot.record() as bag:
        cue(params.bell, "recording")
        if params.person:
            _ask("press Enter when the movement is over ")
        else:
            robot.demonstrate()
    cue(params.bell, "recorded")
    return bag


def _ask(text: str) -> None:
    if not ask(text):
        raise ServiceError("no answer: standard input is closed")


def main() -> int:
    """Run `python -m wam_power_ros.console.teach`."""
    return run_script(Teaching, record_series)
