# SPDX-License-Identifier: Apache-2.0
"""A person's feedback to a running learner, and a demonstration for it during its session."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.logging import LoggingSeverity

from wam_power_interfaces.srv import AddDemonstration, Pause, Rate
from wam_power_ros.client.link import LOG_AFTER, RETRY_PERIOD, TIMEOUT, Link
from wam_power_ros.client.robot import Robot
from wam_power_ros.ros import interface
from wam_power_ros.ros.node_runner import participant
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError

APPEAR_TIMEOUT = 10.0  # [s of wall time] until a service of the learner is available
SERVICES = {  # kind of feedback, or stop -> service and its data
    "reward": (interface.LEARNER_REWARD, None),
    "punish": (interface.LEARNER_PUNISH, None),
    "stop": (interface.STOP, None),
    "pause": (interface.LEARNER_PAUSE, Pause.Request(pause=True)),
    "continue": (interface.LEARNER_PAUSE, Pause.Request(pause=False)),
}


class Feedback:
    """Gives feedback to the learner; the answer may be a refusal."""

    def __init__(self, link: Link) -> None:
        self._link = link

    def give(self, kind: str, bag: Path | None = None, value: float | None = None) -> Answer:
        """Give feedback: of `SERVICES`, a "demonstration", or "rate" with a value from 0 to 1.

        A ServiceError if the learner does not appear or does not answer.
        """
        if kind == "demonstration":
            data = AddDemonstration.Request(bag=str(bag.resolve()))
            name = interface.ADD_DEMONSTRATION
        elif kind == "rate":
            name, data = interface.LEARNER_RATE, Rate.Request(value=value)
        else:
            name, data = SERVICES[kind]
        return self._link.answer(name, data)

    def teach(
        self, robot: Robot, wait: Callable[[], object] | None, notify: Callable[[str], object]
    ) -> Answer:
        """Pause the learner, record a demonstration, hand it over and let the learner continue.

        The arm is set to gravity compensation only after the learner has reported that it is paused
        and no trial is under way; from then on it sends nothing until it continues. After a
        ServiceError the learner may be paused.
        """
        deadline = time.monotonic() + TIMEOUT
        answer = self.give("pause")
        notify(answer.text)
        while answer.under_way:
            if time.monotonic() > deadline:
                raise ServiceError(f"no trial ended in {TIMEOUT:.0f} s; the learner is paused")
            self._link.sleep(RETRY_PERIOD)
            answer = self.give("pause")
        answer = self.give("demonstration", robot.teach(wait))
        self.give("continue")
        return answer


@contextmanager
def connected(domain: int | None = None, quiet: bool = False) -> Iterator[Feedback]:
    """Connect to a learner, in the domain of a simulation; None for that of ROS_DOMAIN_ID.

    With `quiet` nothing is logged while an answer is waited for.
    """
    make = lambda: rclpy.create_node("feedback")  # noqa: E731
    with (
        participant(make, domain, on_loopback=domain is not None) as node,
        Link(node, APPEAR_TIMEOUT, LOG_AFTER) as link,
    ):
        if quiet:
            node.get_logger().set_level(LoggingSeverity.ERROR)
        yield Feedback(link)


def answered(work: Callable[[], Answer]) -> Answer:
    """Answer that some work gives; it says why if there is none."""
    try:
        return work()
    except ServiceError as error:
        return error.answer or Answer(Code.NOT_ACTIVE, str(error))
    except ExternalShutdownException:
        return Answer(Code.NOT_ACTIVE, "the session has ended")
