# SPDX-License-Identifier: Apache-2.0
"""Reflexes of a ROS engineer: what he types without reading, and what then happens.

The nodes are in the test's own process; `ELSEWHERE` points to tests beside other modules.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from conftest import ROOT
from played_arm import HOME, ControllerHere
from rclpy.node import Node
from rclpy.parameter import Parameter
from rigid_arm import make_policy
from std_srvs.srv import Trigger

from hardware_sim.arm_node import ArmSim
from hardware_sim.main import OWN_NAME
from hardware_sim.optitrack_node import OptitrackSim
from wam_power_ros.nodes.body_tracker import BodyTracker

ELSEWHERE = {
    "ros2 run NODE, without any parameter": "system/test_started_by_ros.py::"
    "test_a_node_takes_from_its_defaults_what_no_file_and_no_argument_says",
    "-r __node:=NAME, of every node": "system/test_started_by_ros.py::"
    "test_a_node_with_another_name_has_the_defaults_of_its_kind",
    "parameters=[{'rate': 100.0}] in a launch file of the lab": "params/test_parameter_file.py::"
    "test_a_list_that_a_launch_file_has_written_is_read",
    "one YAML with /** for all nodes": "params/test_overlay.py::"
    "test_a_section_of_all_nodes_reaches_each_that_has_the_parameter",
    "a parameter that is mistyped": "system/test_started_by_ros.py::"
    "test_a_name_that_no_node_knows_is_refused_and_a_neighbour_named",
    "-r __ns:=/left": "system/test_two_arms.py::test_two_arms_in_two_namespaces_learn_side_by_side",
    "ros2 launch": "system/test_launch_files.py::test_ctrl_c_ends_a_launch_cleanly_at_any_moment",
    "Ctrl-C": "test_entry.py::test_a_signal_during_the_imports_ends_a_process_without_a_word",
    "ros2 action send_goal, malformed": "nodes/test_torque_controller_node.py::"
    "test_each_wrong_goal_ends_aborted_with_its_code_and_the_arm_holds",
    "Ctrl-C in ros2 action send_goal": "nodes/test_torque_controller_node.py::"
    "test_a_cancel_stops_the_arm_and_ends_the_goal_and_a_late_one_does_nothing",
    "ros2 topic pub of a JointTrajectory": "nodes/test_torque_controller_node.py::"
    "test_a_movement_on_the_topic_is_played_whatever_its_frame_and_a_bad_one_logged",
    "ros2 interface show": "test_interfaces.py::"
    "test_ros2_shows_the_definitions_with_their_comments",
    "colcon build": "test_build.py::test_colcon_builds_links_and_tests_this_package",
    "colcon build with another Python": "ros/test_environment.py::"
    "test_a_python_without_our_modules_is_named_with_what_it_misses_and_the_remedy",
    "export RMW_IMPLEMENTATION, ROS_LOCALHOST_ONLY and others": "ros/test_environment.py::"
    "test_one_line_names_a_variable_with_which_no_node_can_run",
    "ros2 bag play": "nodes/test_demonstration_recorder_node.py::"
    "test_states_without_velocity_or_effort_are_recorded_and_read_however_they_were_sent",
    "ros2 bag record -a, then our reader": "bags/test_other_recorders.py::"
    "test_no_other_topic_makes_a_bag_unreadable",
    "doctor": "cli/test_doctor_command.py::"
    "test_an_arm_that_was_never_measured_is_sent_to_commission",
    "ros2 node info, ros2 action list": "ros/test_security.py::"
    "test_a_node_does_what_the_policy_allows_and_the_policy_allows_what_it_does",
    "ros2 topic echo, ros2 topic hz": "hardware_sim/test_main.py::"
    "test_in_real_time_states_come_500_times_a_second_with_the_wall_clock",
    "ros2 lifecycle set": "nodes/test_torque_controller_node.py::"
    "test_the_life_cycle_decides_whether_torques_are_sent_and_repeated_states_are_recent",
    "ros2 action send_goal --feedback": "hardware_sim/test_lockstep.py::"
    "test_waypoints_of_a_follow_joint_trajectory_are_passed_and_a_wrong_goal_is_invalid",
    "ros2 service call of stop": "nodes/test_torque_controller_node_faults.py::"
    "test_no_service_says_done_in_a_fault_but_a_stop_that_names_it",
    "ros2 service call of the recorder": "nodes/test_demonstration_recorder_node.py::"
    "test_a_recording_that_cannot_be_is_refused_with_its_reason",
    "two nodes of one name": "hardware_sim/test_driver_watch.py::"
    "test_a_second_simulation_is_refused_and_the_first_goes_on",
}


def test_every_pointer_leads_to_a_test() -> None:
    for place in ELSEWHERE.values():
        file, name = place.split("::")
        assert f"def {name}(" in (ROOT / "test" / file).read_text(), place


def param_set(node: Node, name: str, value: object) -> str:
    """The reason of a refusal, empty if the parameter was set."""
    (result,) = node.set_parameters([Parameter(name, value=value)])
    found = np.array(node.get_parameter(name).value)
    assert result.successful == np.array_equal(found, np.array(value))
    return "" if result.successful else result.reason or "refused"


@pytest.fixture
def plate(node_here: Callable[..., Node]) -> Node:
    """A second tracker, of another body, with a name and a topic of its own."""
    names = "__node:=plate_tracker", "plate/pose:=cameras/plate"
    return node_here(BodyTracker, "pancake_tracker.yaml", remap=names, body="plate")


def test_a_second_tracker_has_the_names_that_it_was_given_in_graph_topics_and_diagnostics(
    plate: Node,
) -> None:
    assert plate.get_name() == "plate_tracker"
    published = {publisher.topic_name for publisher in plate.publishers}
    assert {"/plate/state", "/rollout/plate"} <= published
    assert "/cameras/plate" in {each.topic_name for each in plate.subscriptions}
    assert plate._diagnostics._of[0].startswith("plate_tracker: ")


def test_param_given_to_a_process_of_two_nodes_reaches_the_one_that_has_it(
    node_here: Callable[..., Node],
) -> None:
    files = "wam_sim.yaml", "optitrack_sim.yaml"
    arm = node_here(ArmSim, *files, seed=3, rate=100.0, urdf="urdf/wam7.urdf")
    cameras = OptitrackSim(cli_args=OWN_NAME)
    assert (arm.params.seed, cameras.params.rate) == (3, 100.0)
    cameras.destroy_node()


def test_param_describe_says_what_may_be_set_at_rest(plate: Node) -> None:
    speed, rate = (plate.describe_parameter(name) for name in ("speed_max", "rate"))
    assert (speed.read_only, rate.read_only) == (False, True)
    assert "at rest" in speed.additional_constraints
    assert "restart the node" in rate.additional_constraints


def test_param_set_of_gates_and_latency_of_a_tracker_is_taken_unless_it_cannot_be(
    plate: Node,
) -> None:
    for name, value in (("latency_offset", 0.004), ("speed_max", 9.0), ("noise", 0.002)):
        assert param_set(plate, name, value) == ""
    assert param_set(plate, "workspace_low", [-2.0, -2.0, -0.5]) == ""
    assert plate._params.speed_max == plate._tracker._settings.speed_max == 9.0
    assert param_set(plate, "speed_max", 900.0)
    against = param_set(plate, "workspace_low", [-2.0, -2.0, 40.0])
    assert "must be below workspace_high" in against
    assert param_set(plate, "rate", 50.0)


@pytest.fixture
def held(controller_here: Callable[..., ControllerHere]) -> ControllerHere:
    """A controller that holds an arm."""
    arm = controller_here()
    assert arm.configure()
    arm.send()
    assert arm.activate()
    assert {arm.send() for _ in range(200)} == {"hold"}
    return arm


def test_param_set_of_the_speed_of_moves_at_rest_and_not_in_a_movement(
    held: ControllerHere,
) -> None:
    node = held.node
    assert param_set(node, "elbow_speed_max", 1.9)  # read at the start
    assert param_set(node, "move_speed", 0.05) == ""
    assert node._controller.settings.move_speed == 0.05
    assert param_set(node, "move_speed", -1.0)
    node._controller.load(make_policy(q_start=HOME + 0.3 * np.eye(7)[3]))
    node._controller.move_to_start()
    assert held.send() == "move_to_start"
    assert "mode" in param_set(node, "move_speed", 1.0)
    node._on_stop(Trigger.Request(), Trigger.Response())
    for _ in range(200):
        held.send()
    assert param_set(node, "move_speed", 1.0) == ""


def test_param_set_of_the_torque_share_goes_down_and_only_while_not_active(
    held: ControllerHere,
) -> None:
    node = held.node
    assert "not active" in param_set(node, "torque_share", 0.9)
    node.trigger_deactivate()
    before = node._controller.limits.torque
    assert param_set(node, "torque_share", 0.9) == ""
    np.testing.assert_allclose(node._controller.limits.torque, 0.9 * before)
    assert "only lowered" in param_set(node, "torque_share", 0.95)
    held.send()
    assert held.activate()
