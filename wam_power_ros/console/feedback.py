# SPDX-License-Identifier: Apache-2.0
"""Send a person's feedback to a running learner."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.logging import LoggingSeverity

from wam_power_ros.client.feedback import Feedback
from wam_power_ros.client.link import LOG_AFTER, Link
from wam_power_ros.ros.node_runner import participant
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError

APPEAR_TIMEOUT = 10.0  # [s of wall time] until a service of the learner is available


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


def given(
    feedback: Feedback, kind: str, bag: Path | None = None, value: float | None = None
) -> Answer:
    """Give feedback, see `Feedback.give`; the answer says why if it could not be given."""
    try:
        return feedback.give(kind, bag, value)
    except ServiceError as error:
        text = f"{error}; does a learner run with the same ROS_DOMAIN_ID?"
        return Answer(Code.NOT_ACTIVE, text)
    except ExternalShutdownException:
        return Answer(Code.NOT_ACTIVE, "the session has ended")
