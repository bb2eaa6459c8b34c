# SPDX-License-Identifier: Apache-2.0
"""Send a person's feedback to a running learner through its services."""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports, which a signal may interrupt
    from wam_power_ros.entry import INTERRUPTED, start

    raise SystemExit(start("wam_power_ros.console.feedback", INTERRUPTED))

import sys
import time
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.console.prompt import show
from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import Code
from wam_power_ros.ros.node_runner import participant, run_script
from wam_power_ros.ros.service_client import LOG_AFTER, TIMEOUT, ServiceClient, ServiceError

APPEAR_TIMEOUT = 10.0  # [s of wall time] until a service of the learner is available
REQUESTS = {
    "reward": (interface.LEARNER_REWARD, Trigger, Trigger.Request()),
    "punish": (interface.LEARNER_PUNISH, Trigger, Trigger.Request()),
    "demonstration": (interface.LEARNER_DEMONSTRATION, Trigger, Trigger.Request()),
    "pause": (interface.LEARNER_PAUSE, SetBool, SetBool.Request(data=True)),
    "continue": (interface.LEARNER_PAUSE, SetBool, SetBool.Request(data=False)),
}


def give(kind: str, bag: Path | None = None, namespace: str = "") -> tuple[bool, str]:
    """Send feedback to the learner in this DDS domain.

    Args:
        kind: One of `REQUESTS`.
        bag: Bag of the demonstration, for the kind "demonstration".
        namespace: Namespace of the learner.

    Returns:
        Whether the learner accepted the feedback, and its answer.
    """
    try:
        make = lambda: rclpy.create_node("feedback", namespace=namespace)  # noqa: E731
        with participant(make, SignalHandlerOptions.NO) as node:
            calls = ServiceClient(node, None, APPEAR_TIMEOUT, LOG_AFTER)
            return _call(calls, node, kind, bag)
    except ServiceError as error:
        return False, f"{error}; does a learner run with the same ROS_DOMAIN_ID?"


def _answer_lines(node: Node) -> None:
    """Send the kind of feedback named on each input line; print one line per answer."""
    calls = ServiceClient(node, appear_timeout=APPEAR_TIMEOUT)
    for kind in map(str.strip, sys.stdin):
        try:
            accepted, answer = _call(calls, node, kind, None)
        except ServiceError as error:
            accepted, answer = False, str(error)
        show(answer if accepted else f"{kind} refused: {answer}")


def _call(calls: ServiceClient, node: Node, kind: str, bag: Path | None) -> tuple[bool, str]:
    name, service, request = REQUESTS[kind]
    if bag is not None:
        publisher = node.create_publisher(String, interface.LEARNER_BAG, interface.LATCHED)
        publisher.publish(String(data=str(bag.resolve())))
    deadline = time.monotonic() + TIMEOUT
    while True:
        answer = calls.call(service, name, request)
        if answer is None:
            raise ServiceError(f"{name} did not answer in {TIMEOUT:.0f} s")
        # topics and services are not ordered: the learner may not have received the bag yet
        early = bag is not None and answer.code is Code.NOTHING
        if not early or time.monotonic() > deadline:
            return answer.success, answer.text
        calls.until(lambda: False, timeout=0.05)


def main() -> int:
    """Run `python -m wam_power_ros.console.feedback`, which reads from standard input."""
    return run_script(lambda: rclpy.create_node("feedback"), _answer_lines)
