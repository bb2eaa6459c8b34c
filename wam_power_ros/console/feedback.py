# SPDX-License-Identifier: Apache-2.0
"""A person's word to a running learner: its services, for who has no ros2 command line."""

from __future__ import annotations

import time
from pathlib import Path

import rclpy
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.ros import interface
from wam_power_ros.ros.node_runner import number_by_process
from wam_power_ros.ros.service_client import TIMEOUT, ServiceCalls, ServiceError

WORDS = {
    "reward": (interface.LEARNER_REWARD, Trigger, Trigger.Request()),
    "punish": (interface.LEARNER_PUNISH, Trigger, Trigger.Request()),
    "demonstration": (interface.LEARNER_DEMONSTRATION, Trigger, Trigger.Request()),
    "pause": (interface.LEARNER_PAUSE, SetBool, SetBool.Request(data=True)),
    "continue": (interface.LEARNER_PAUSE, SetBool, SetBool.Request(data=False)),
}


def tell(word: str, bag: Path | None = None) -> tuple[bool, str]:
    """Say something to the learner of this DDS domain.

    Args:
        word: One of `WORDS`.
        bag: Of a demonstration, for the word "demonstration".

    Returns:
        Whether it took it up, and its answer.
    """
    context = rclpy.Context()
    rclpy.init(context=context)
    try:
        with number_by_process():
            node = rclpy.create_node("tell", context=context)
        return _tell(node, word, bag)
    except ServiceError as error:
        return False, f"{error}; is there a learner with the same ROS_DOMAIN_ID?"
    finally:
        rclpy.shutdown(context=context)


def _tell(node: Node, word: str, bag: Path | None) -> tuple[bool, str]:
    name, kind, request = WORDS[word]
    calls = ServiceCalls(node)
    if bag is not None:
        named = node.create_publisher(String, interface.LEARNER_BAG, interface.LATCHED)
        named.publish(String(data=str(bag.resolve())))
    end = time.monotonic() + TIMEOUT
    while True:
        answer = calls.call(kind, name, request)
        early = bag is not None and answer.message == interface.NO_BAG  # it has not heard of it yet
        if not early or time.monotonic() > end:
            return answer.success, answer.message
        calls.until(lambda: False, 0.05)
