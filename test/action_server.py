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
from wam_power_interfaces.msg import Outcome, RolloutEnd


def execute(goal: ServerGoalHandle) -> ExecutePolicy.Result:
    """Publish feedback until the goal is cancelled."""
    wanted = goal.request
    if wanted.policy.id == "refused":
        goal.abort()
        why = Outcome(code=Outcome.REFUSED, text=f"no policy {wanted.policy.text}")
        return ExecutePolicy.Result(outcome=why)
    for _ in range(10_000):
        if goal.is_cancel_requested:
            goal.canceled()
            end = RolloutEnd(policy_id=wanted.policy.id)
            return ExecutePolicy.Result(outcome=Outcome(code=Outcome.STOPPED), end=end)
        goal.publish_feedback(ExecutePolicy.Feedback(stage="moving"))
        time.sleep(0.01)
    goal.succeed()
    return ExecutePolicy.Result()


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
