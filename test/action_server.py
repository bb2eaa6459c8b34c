# SPDX-License-Identifier: Apache-2.0
"""A process that serves `execute`: refuses the policy "refused", others last until cancelled."""

from __future__ import annotations

import time

import rclpy
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor

from wam_power_interfaces.action import ExecutePolicy
from wam_power_interfaces.msg import Outcome


def execute(goal: ServerGoalHandle) -> ExecutePolicy.Result:
    """Publish feedback until the goal is cancelled."""
    wanted = goal.request
    if wanted.id == "refused":
        goal.abort()
        return ExecutePolicy.Result(outcome=Outcome.REFUSED, reason=f"no policy {wanted.policy}")
    for step in range(10_000):
        if goal.is_cancel_requested:
            goal.canceled()
            return ExecutePolicy.Result(outcome=Outcome.STOPPED, policy_id=wanted.id)
        goal.publish_feedback(ExecutePolicy.Feedback(stage="executing", progress=step * 1e-4))
        time.sleep(0.01)
    goal.succeed()
    return ExecutePolicy.Result(outcome=Outcome.DONE)


def main() -> None:
    """Serve until a signal."""
    rclpy.init()
    node = rclpy.create_node("server", namespace="")
    group = ReentrantCallbackGroup()
    accept = lambda _: CancelResponse.ACCEPT  # noqa: E731
    ActionServer(
        node, ExecutePolicy, "execute", execute, cancel_callback=accept, callback_group=group
    )
    try:
        rclpy.spin(node, MultiThreadedExecutor(2))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
