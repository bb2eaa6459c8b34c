# SPDX-License-Identifier: Apache-2.0
"""Demonstration during a session, from the page: pause, record, learn, continue.

The arm is set to gravity compensation only after the learner has reported that it is paused and no
trial is under way; from then on it sends nothing until it continues.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import Answer, Code
from wam_power_ros.view.live import View

SERVICE_TIMEOUT = 60.0  # [s of wall time] until a refused service succeeds
RETRY_PERIOD = 0.2  # [s of wall time]


class NotTaughtError(RuntimeError):
    """The demonstration failed; the message says why. The learner may be paused."""


def begin(node: View, notify: Callable[[str], object]) -> None:
    """Pause the learner, start gravity compensation and begin to record.

    Args:
        node: Node with the services of the session.
        notify: Called with each progress message.

    Raises:
        NotTaughtError: A service refused, or the trial did not end.
    """
    deadline = time.monotonic() + SERVICE_TIMEOUT
    answer = _insist(node, interface.LEARNER_PAUSE, True)
    notify(answer.text)
    while answer.values.get("trial") != "over":
        if time.monotonic() > deadline:
            raise NotTaughtError(
                f"no trial ended in {SERVICE_TIMEOUT:.0f} s; the learner is paused"
            )
        time.sleep(RETRY_PERIOD)
        answer = _insist(node, interface.LEARNER_PAUSE, True)
    _insist(node, interface.GRAVITY_COMPENSATION, True)
    try:
        if node.is_offered(interface.DEMONSTRATE):  # stand-in: arm and body back to the start
            _insist(node, node.reset, None)
        _insist(node, interface.RECORD, True)
        if node.is_offered(interface.DEMONSTRATE):
            notify("the simulated demonstrator guides the arm")
            _insist(node, interface.DEMONSTRATE, None)
        else:
            notify("guide the arm by hand, then press End of movement")
    except NotTaughtError:
        node.call(interface.RECORD, False)
        node.call(interface.GRAVITY_COMPENSATION, False)  # the arm holds
        raise


def finish(node: View) -> str:
    """End the recording, hold the arm, hand the bag to the learner and let it continue.

    Returns:
        Answer of the learner.

    Raises:
        NotTaughtError: A service refused, such as the learner; the message says why.
    """
    try:
        bag = Path(_insist(node, interface.RECORD, False).text)
    finally:
        _insist(node, interface.GRAVITY_COMPENSATION, False)
    node.publish_bag(bag.resolve())
    deadline = time.monotonic() + SERVICE_TIMEOUT
    while True:  # topics and services are not ordered: the path may arrive after the request
        answer = node.call(interface.LEARNER_DEMONSTRATION)
        if answer.code is not Code.NOTHING or time.monotonic() > deadline:
            break
        time.sleep(RETRY_PERIOD)
    _insist(node, interface.LEARNER_PAUSE, False)
    if not answer.success:
        raise NotTaughtError(answer.text)
    return answer.text


def _insist(node: View, name: str, on: bool | None) -> Answer:
    """Call a service until it succeeds."""
    deadline = time.monotonic() + SERVICE_TIMEOUT
    while True:
        answer = node.call(name, on)
        if answer.success:
            return answer
        if time.monotonic() > deadline:
            raise NotTaughtError(f"{name}: {answer.text}")
        time.sleep(RETRY_PERIOD)
