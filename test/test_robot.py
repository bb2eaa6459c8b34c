# SPDX-License-Identifier: Apache-2.0
"""The robot object: the example of its page is run here (`py`, not `python`: only here)."""

from __future__ import annotations

import os
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from rclpy.node import Node
from test_docs import blocks

from wam_power_ros import robot
from wam_power_ros.params import overlay
from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import Answer, Code
from wam_power_ros.view.live import View


@pytest.fixture(scope="module")
def example() -> dict[str, Any]:
    """Variables of the example after its run over DDS."""
    before, names = dict(os.environ), {}
    (block,) = blocks("docs/robot.md", "py")
    exec(compile(block, "docs/robot.md", "exec"), names)
    assert dict(os.environ) == before
    return names


def test_the_arm_holds_at_the_requested_posture(example: dict[str, Any]) -> None:
    start, moved = example["start"], example["moved"]
    np.testing.assert_allclose(moved.q, example["home"], atol=0.02)
    assert np.abs(moved.qd).max() < 0.05
    position, _ = example["wam"].arm.tool_pose(moved.q)
    np.testing.assert_array_equal(moved.position, position)
    assert np.linalg.norm(moved.position - start.position) > 0.02


def test_the_taught_demonstration_was_replayed(example: dict[str, Any]) -> None:
    assert np.ptp(example["demonstration"].position[:, 2]) > 0.1
    assert "rms" in example["tracking"]


def test_a_rollout_follows_its_policy_and_is_recorded(example: dict[str, Any]) -> None:
    executed, policy = example["executed"], example["policy"]
    assert executed.rollout.fault is None and executed.rollout.tool.id == policy.id
    first = executed.rollout.tool.position[0]
    np.testing.assert_allclose(first, example["demonstration"].position[0], atol=0.02)
    assert len(executed.rollout.body.t) > 10 and executed.bag.startswith("rollout")


def test_a_posture_beyond_the_limits_is_refused_before_anything_is_sent() -> None:
    never = robot.Robot.__new__(robot.Robot)
    never.arm = robot.Arm(
        robot.share("urdf/wam7.urdf").read_text(), [f"wam_j{i}" for i in range(1, 8)]
    )
    for q in ([0.0] * 6, [0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0], [np.nan] * 7):
        with pytest.raises(ValueError, match="must be 7 angles within"):
            never.move_to(q)


def test_an_unknown_set_up_is_refused() -> None:
    with pytest.raises(ValueError, match="no set-up 'nonesuch'"), robot.connect("nonesuch"):
        pass


def test_an_interrupt_stops_the_arm() -> None:
    moving, stopped = robot.Robot.__new__(robot.Robot), []
    moving.stop = lambda: stopped.append(True)
    with pytest.raises(KeyboardInterrupt), moving._stopping():
        raise KeyboardInterrupt
    assert stopped == [True]


def test_a_controller_that_is_busy_is_asked_again_and_one_that_refuses_is_not() -> None:
    for code in (Code.DONE, Code.REFUSED):
        answers = [Answer(code, "then"), Answer(Code.BUSY, "not read within 5 s")]
        asking = robot.Robot.__new__(robot.Robot)
        asking._calls = SimpleNamespace(call=lambda *_, timeout: answers.pop())  # noqa: B023
        assert asking._request_replay() == Answer(code, "then")


def names(node: Node) -> set[str]:
    """Topics and services of a node, without those of every node."""
    of = (node.get_name(), node.get_namespace())
    found = [
        *node.get_publisher_names_and_types_by_node(*of),
        *node.get_subscriber_names_and_types_by_node(*of),
        *node.get_client_names_and_types_by_node(*of),
    ]
    return {name for name, _ in found} - {"/rosout", "/parameter_events", interface.DIAGNOSTICS}


def test_robot_and_page_use_the_names_of_their_namespace(domain_id: int) -> None:
    setup = overlay.setup()
    rclpy.init(domain_id=domain_id)
    try:
        node = rclpy.create_node("robot", namespace="left")
        robot.Robot(node, setup)
        of_listener = node.get_subscriber_names_and_types_by_node("robot_states", "/left")
        listener = {name for name, _ in of_listener}
        page = View(setup["torque_controller"], "pancake", "/left")
        used = names(node) | listener | names(page)
        assert {"/left/controller/stop", "/left/joint_states", "/left/learner/reward"} <= used
        assert {name for name in used if not name.startswith("/left/")} == set()
    finally:
        rclpy.shutdown()
