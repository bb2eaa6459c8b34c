# SPDX-License-Identifier: Apache-2.0
"""Send a person's feedback to a running learner."""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports, which a signal may interrupt
    from wam_power_ros.entry import INTERRUPTED, start

    raise SystemExit(start("wam_power_ros.console.feedback", INTERRUPTED))

import sys
from pathlib import Path

import rclpy
from rclpy.node import Node

from wam_power_ros.client.feedback import Feedback
from wam_power_ros.client.link import LOG_AFTER, Link
from wam_power_ros.console.prompt import show
from wam_power_ros.ros.node_runner import participant, run_script
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError

APPEAR_TIMEOUT = 10.0  # [s of wall time] until a service of the learner is available


def give(
    kind: str,
    bag: Path | None = None,
    value: float | None = None,
    namespace: str = "",
    domain: int | None = None,
) -> Answer:
    """Send feedback to the learner.

    Args:
        kind: As for `Feedback.give`, with what it needs.
        bag: Bag of the demonstration, for the kind "demonstration".
        value: Rating from 0 to 1, for the kind "rate".
        namespace: Namespace of the learner.
        domain: DDS domain of a simulation; None for that of ROS_DOMAIN_ID.

    Returns:
        Answer of the learner, or why there is none.
    """
    make = lambda: rclpy.create_node("feedback", namespace=namespace)  # noqa: E731
    try:
        with (
            participant(make, domain, on_loopback=domain is not None) as node,
            Link(node, APPEAR_TIMEOUT, LOG_AFTER) as link,
        ):
            return Feedback(link).give(kind, bag, value)
    except ServiceError as error:
        text = f"{error}; does a learner run with the same ROS_DOMAIN_ID?"
        return Answer(Code.NOT_ACTIVE, text)


def _answer_lines(node: Node) -> None:
    """Send the feedback named on each input line, "rate" with a value; print a line per answer."""
    with Link(node, APPEAR_TIMEOUT) as link:
        feedback = Feedback(link)
        for line in sys.stdin:
            kind, _, value = line.strip().partition(" ")
            try:
                answer = feedback.give(kind, value=float(value) if value else None)
            except ServiceError as error:
                answer = Answer(Code.NOT_ACTIVE, str(error))
            show(answer.text if answer.success else f"{kind} refused: {answer.text}")


def main() -> int:
    """Run `python -m wam_power_ros.console.feedback`, which reads from standard input."""
    return run_script(lambda: rclpy.create_node("feedback"), _answer_lines)
