# SPDX-License-Identifier: Apache-2.0
"""Guards of topics: against a second commander, a second publisher of states, and real drivers."""

from __future__ import annotations

import functools
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from wam_power_ros.ros import interface

SILENCE_TIMEOUT = 0.5  # [s] after its last message, a publisher counts as gone: another is followed
_OWN_MAX = 200  # own commands to recognise when they are received: of 0.2 s at 1 kHz
REMEMBERED = 2.0  # [s] for which a state of another publisher is remembered: some send one a second
SKIPPED_MAX = 1000  # messages of one publisher between two states of the arm: lost, or of others
Info = Mapping[str, int | None]  # information that rclpy gives with a message
STAND_IN = "wam_sim"  # node that publishes the joint states of a simulated arm
UNNAMED = "_NODE_NAME_UNKNOWN_"  # the node's name is not discovered yet, or it is no ROS node


class CommandGuard:
    """Subscribes to the topic while the node sends nothing; counts its publishers while it sends.

    A killed commander stays announced for 20 s. If it sends nothing, the node may begin to send,
    but stays subscribed until the other is gone. A commander that appears later is a fault.
    """

    def __init__(self, node: Node, publisher: Publisher) -> None:
        self._node, self._publisher = node, publisher
        self._foreign_time = -SILENCE_TIMEOUT  # of another's last command [s, steady clock]
        self._others = 0  # publishers at the last count
        self._own: deque[bytes] = deque(maxlen=_OWN_MAX)  # commands sent while subscribed
        self._subscription: Subscription | None = None
        self.listen()

    @property
    def foreign(self) -> bool:
        """Whether another publisher sends commands, as far as we are subscribed."""
        return time.monotonic() - self._foreign_time < SILENCE_TIMEOUT

    def listen(self) -> None:
        """Subscribe to the commands of others."""
        if self._subscription is None:
            self._subscription = self._node.create_subscription(
                self._publisher.msg_type,
                self._publisher.topic_name,
                self._on_command,
                interface.STATE_IN,
                raw=True,
            )

    def begin(self) -> str | None:
        """Begin to send; returns the reason why this is not possible yet, or None."""
        if self.foreign:
            return f"another publisher sends commands on {self._publisher.topic_name}; end it first"
        self._others = self._count_others()
        self._unsubscribe_if_alone()
        return None

    def publish(self, command: bytes) -> None:
        """Send a command."""
        if self._subscription is not None:
            self._own.append(command)
        self._publisher.publish(command)

    def unexpected_publisher(self) -> str | None:
        """Text for a fault if publishers have appeared since the last call, else None."""
        others, before = self._count_others(), self._others
        self._others = others
        self._unsubscribe_if_alone()
        if others <= before:
            return None
        count = f"{others} other publisher{'s' * (others > 1)}"
        return f"{count} on the command topic {self._publisher.topic_name}"

    def _unsubscribe_if_alone(self) -> None:
        if self._others == 0 and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
            self._own.clear()

    def _count_others(self) -> int:
        return self._node.count_publishers(self._publisher.topic_name) - 1

    def _on_command(self, command: bytes) -> None:
        if not any(command.startswith(own) for own in reversed(self._own)):
            self._foreign_time = time.monotonic()


def with_info(callback: Callable[[Any, Info], None]) -> Callable[..., None]:
    """Callback of a subscription that gets message and information from any executor.

    The events executor passes them as one tuple, the others as two arguments.
    """
    both = lambda *given: callback(*(given[0] if len(given) == 1 else given))  # noqa: E731
    return functools.wraps(callback)(both)


def _continues(number: int, last: int) -> bool:
    return 0 < number - last <= SKIPPED_MAX


class StateGuard:
    """Follows the publisher whose states are used, and recognises the states of another.

    Several nodes may publish on one topic, each the joints of its own device. rclpy does not tell
    who sent a message, but every publisher numbers its own: a number that does not continue those
    of the publisher that is followed is that of another one. A killed driver stays announced for
    20 s, but sends nothing, so that its successor is followed. A middleware that does not number
    messages (such as Cyclone DDS) hides a second publisher.
    """

    def __init__(self, node: Node, topic: str) -> None:
        self._node, self._topic = node, node.resolve_topic_name(topic)
        # Numbers and times [s, steady clock] of the last states: followed, and of another.
        self._number = self._other = 0
        self._heard = self._other_heard = -REMEMBERED
        self._in_turn = False  # the other was heard between two states that were followed

    def follows(self, info: Info, active: bool = False) -> bool:
        """Whether a message with joints of the arm is from the publisher that is followed.

        Args:
            info: Information that came with the message.
            active: Whether torques are sent. A publisher that was heard in turn with the one that
                is followed does not take its place then, however long that one is silent.
        """
        now, number = time.monotonic(), info["publication_sequence_number"]
        if number is None:
            return True
        ours = _continues(number, self._number)
        others = self._in_turn and _continues(number, self._other)
        silent = now - self._heard >= SILENCE_TIMEOUT
        if ours and others:  # of the one whose last number is nearer
            others = self._other >= self._number + (not silent)
            ours = not others
        if (others and active) or not (ours or silent):
            self._other, self._other_heard = number, now
            return False
        self._in_turn |= ours and self._other_heard > self._heard
        self._number, self._heard = number, now
        return True

    def second_publisher(self) -> str | None:
        """Text that names the publishers if another one has sent states, else None."""
        if time.monotonic() - self._other_heard >= REMEMBERED:
            return None
        nodes = ", ".join(interface.publishers(self._node, self._topic))
        return f"more than one publisher sends states of these joints on {self._topic}: {nodes}"


def described(name: str) -> str:
    """Name of a node as it is discovered, for a sentence."""
    return "a participant without a node name" if name == UNNAMED else f"node {name!r}"


class SimulationGuard:
    """Looks who publishes the joint states that a controller in simulation answers.

    A stand-in is recognised by the name of its node, as `hardware_sim.driver_watch` does. An arm,
    whose controller is not `simulated`, needs no guard.
    """

    def __init__(self, node: Node, topic: str, simulated: bool, lockstep: bool) -> None:
        self._node, self._topic = node, node.resolve_topic_name(topic)
        self._simulated, self._lockstep = simulated, lockstep
        self._clock = node.resolve_topic_name(interface.CLOCK)
        self._unnamed = False  # at the last call of `unexpected_publisher`

    def other_publisher(self) -> str | None:
        """Describe a publisher of joint states that is no stand-in; None if there is none."""
        name = self._other_publisher()
        if name is None:
            return None
        return (
            f"{described(name)} publishes {self._topic}, and this controller is for a simulation: "
            f"it answers the stand-in {STAND_IN!r} only; for an arm set simulation: false"
        )

    def other_clock(self) -> str:
        """Say that stand-in and controller follow different clocks; empty if they do not."""
        if not self._simulated:
            return ""
        published = bool(self._node.count_publishers(self._clock))
        if published and not self._lockstep:
            return (
                f"the stand-in runs in lockstep and publishes {self._clock}, this controller in "
                "real time: set use_sim_time: true for all nodes, or pace: real_time for the "
                "stand-in"
            )
        if self._lockstep and self._node.get_parameter("use_sim_time").value and not published:
            return (
                f"no node publishes {self._clock}, and this controller follows simulated time: set "
                "pace: lockstep for the stand-in, or use_sim_time: false for all nodes"
            )
        return ""

    def unexpected_publisher(self) -> str | None:
        """As `other_publisher`, but one whose name is not discovered yet has until the next call.

        The name of a node arrives milliseconds after its topics.
        """
        unnamed, self._unnamed = self._unnamed, self._other_publisher() == UNNAMED
        return None if self._unnamed and not unnamed else self.other_publisher()

    def _other_publisher(self) -> str | None:
        if not self._simulated:
            return None
        names = {each.node_name for each in self._node.get_publishers_info_by_topic(self._topic)}
        return min(names - {STAND_IN}, default=None)
