# SPDX-License-Identifier: Apache-2.0
"""Messages that could delay the loop: the largest valid one of each kind, and invalid ones.

`benchmark.latency` runs this in a separate process, which publishes each message and saves the
times of publication.
"""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, String
from trajectory_msgs.msg import JointTrajectory

from benchmark.nodes import HOME, JOINTS, PERIOD_NS
from wam_power_ros.learning.policy import COUNT_MAX, DURATION_MAX, Basis, Policy, to_json
from wam_power_ros.ros import interface, joint_messages, node_runner
from wam_power_ros.ros.requests import Request
from wam_power_ros.ros.stamps import time_message

POINTS = 200_000
BAD_STATE = "/benchmark/bad_state"  # requests one from the stand-in, the only source of states
WINDOW = 6.0  # [s] after each message in which missed periods are counted


def largest_policy() -> str:
    """Text of a policy of 200 spring-dampers over 60 s, every number with all digits."""
    rng = np.random.default_rng(1)
    spread = rng.uniform(-1.0, 1.0, (COUNT_MAX, 3, 3))
    policy = Policy(
        id="largest",
        basis=Basis(COUNT_MAX, DURATION_MAX, 0.1),
        stiffness=300.0 * np.eye(3) + spread + spread.transpose(0, 2, 1),
        attractors=rng.uniform(0.3, 0.6, (COUNT_MAX, 3)),
        damping=32.0,
        orientation_reference=np.array([0.0, 0.0, 0.0, 1.0]),
        rotation_attractors=rng.uniform(-0.1, 0.1, (COUNT_MAX, 3)),
        rotation_stiffness=400.0,
        rotation_damping=36.0,
        q_start=HOME,
    )
    return to_json(policy)


def longest_movement() -> JointTrajectory:
    """Movement of 200 000 points in 600 s."""
    t = np.linspace(0.0, 600.0, POINTS)
    q = HOME + 0.1 * np.sin(0.1 * t)[:, None]
    return joint_messages.movement_message(JOINTS, joint_messages.JointMovement(t, q))


def bad_state() -> JointState:
    """Joint state with NaN positions."""
    message = JointState(name=JOINTS, position=[float("nan")] * len(JOINTS))
    message.header.stamp = time_message(time.time_ns())
    return message


class Messages(Node):
    """Publishes each message and records the times."""

    def __init__(self, report: Path) -> None:
        super().__init__("messages")
        self._report = report
        make = self.create_publisher
        policies = make(String, interface.CONTROLLER_REQUEST, interface.REQUESTS)
        movements = make(JointTrajectory, interface.REPLAY, interface.REQUESTS)
        states = make(Empty, BAD_STATE, interface.COMMAND)
        policy = Request("move_to_start", {"policy": largest_policy()}).message()
        movement = longest_movement()
        movement.header.frame_id = Request("replay").id
        self._messages: list[tuple[str, Publisher | None, Callable[[], object]]] = [
            ("nothing", None, lambda: None),
            ("first refusal: a NaN state", states, Empty),
            ("second refusal: `{` as a request", policies, lambda: String(data="{")),
            ("1 MB of invalid data as a request", policies, lambda: String(data="{" * 1_000_000)),
            (f"policy of {COUNT_MAX} primitives, 60 s", policies, lambda: policy),
            (f"movement of {POINTS} points", movements, lambda: movement),
            ("17 MB of invalid data as a request", policies, lambda: String(data="{" * 17_000_000)),
        ]

    def run(self) -> int:
        """Publish all messages, WINDOW seconds apart, then wait for a signal."""
        time.sleep(8.0)  # for discovery, and the start of the controller
        times = []
        for name, publisher, make in self._messages:
            message = make()
            times.append((name, time.monotonic_ns()))
            if publisher is not None:
                publisher.publish(message)
            time.sleep(WINDOW)
        partial = self._report.with_suffix(".part")
        partial.write_text(json.dumps(times))
        partial.rename(self._report)
        signal.pause()
        return 0


def publish(report: Path) -> int:
    """Run the node; the times are written to `report`."""
    return node_runner.run_script(lambda: Messages(report), Messages.run)


def table(rows: np.ndarray, times: list[tuple[str, int]]) -> str:
    """Format the periods missed by controller and echo after each message.

    Args:
        rows: Times at which each state was sent and answered by either (0 if never) [ns].
            Shape (states, 3).
        times: Name and time of publication of each message [ns].
    """
    lines = [
        f"periods missed within {WINDOW:.0f} s (longest time to a torque [ms])",
        f"  {'message':40s}{'controller':>18s}{'echo':>18s}",
    ]
    for name, at in times:
        # From one period earlier: a state sent just before may be answered just after.
        within = rows[(rows[:, 0] >= at - PERIOD_NS) & (rows[:, 0] < at + WINDOW * 1e9 - PERIOD_NS)]
        cells = ""
        for column in (1, 2):
            answered = within[within[:, column] > 0]
            took = answered[:, column] - answered[:, 0]
            missed = np.count_nonzero(took > PERIOD_NS) + len(within) - len(answered)
            longest = took.max(initial=0) * 1e-6
            cells += f"{missed:8d} ({longest:7.1f})"
        lines.append(f"  {name:40s}{cells}")
    return "\n".join(lines)
