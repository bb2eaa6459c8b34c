# SPDX-License-Identifier: Apache-2.0
"""A person's word to a running learner: its services, for who has no ros2 command line."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from wam_power_ros import interface

WORDS = {
    "reward": (interface.LEARNER_REWARD, Trigger, Trigger.Request()),
    "punish": (interface.LEARNER_PUNISH, Trigger, Trigger.Request()),
    "demonstration": (interface.LEARNER_DEMONSTRATION, Trigger, Trigger.Request()),
    "pause": (interface.LEARNER_PAUSE, SetBool, SetBool.Request(data=True)),
    "continue": (interface.LEARNER_PAUSE, SetBool, SetBool.Request(data=False)),
}
TIMEOUT = 60.0  # for a learner to be found and to answer [s of wall time]


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
        return _Teller(context).tell(word, bag)
    finally:
        rclpy.shutdown(context=context)


class _Teller:
    def __init__(self, context: rclpy.Context) -> None:
        self._node = rclpy.create_node("tell", context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)
        self._end = time.monotonic() + TIMEOUT

    def tell(self, word: str, bag: Path | None) -> tuple[bool, str]:
        name, kind, request = WORDS[word]
        client = self._node.create_client(kind, name)
        if not self._until(client.service_is_ready):
            return False, f"no learner offers {name}; is it the same ROS_DOMAIN_ID?"
        if bag is not None:
            named = self._node.create_publisher(String, interface.LEARNER_BAG, interface.LATCHED)
            named.publish(String(data=str(bag.resolve())))
        while True:
            future = client.call_async(request)
            if not self._until(future.done):
                return False, f"no answer of {name} within {TIMEOUT:.0f} s"
            answer = future.result()
            early = bag is not None and answer.message == interface.NO_BAG
            if not early or time.monotonic() > self._end:
                return answer.success, answer.message
            self._spin()

    def _until(self, condition: Callable[[], bool]) -> bool:
        while not condition():
            if time.monotonic() > self._end:
                return False
            self._spin()
        return True

    def _spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.05)
