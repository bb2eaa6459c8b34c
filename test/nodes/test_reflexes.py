# SPDX-License-Identifier: Apache-2.0
"""Forty reflexes of a ROS engineer: what he types without reading, and what then happens.

The tests of this file share one session of real nodes, in lockstep; `ELSEWHERE` points to those
that exist beside their modules. `ros2` is not among the wheels: what it asks a graph is asked here.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from conftest import ROOT, Probe, Processes, diagnosis, lift
from control_msgs.action import FollowJointTrajectory
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import GetAvailableTransitions, GetState
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Log, Parameter, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.action import get_action_names_and_types
from rclpy.action.graph import get_action_server_names_and_types_by_node
from rclpy.parameter import Parameter as Value
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.control.modes import Mode
from wam_power_ros.params import overlay
from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.ros.domain import private_domain
from wam_power_ros.ros.outcomes import Code
from wam_power_ros.ros.stamps import nanoseconds

TRACKER = "wam_power_ros.nodes.body_tracker"
FILES = [str(ROOT / f"config/{name}.yaml") for name in ("simulation", "lockstep")]
CONTROLLER, PLATE = "torque_controller", "plate_tracker"
OWN = {  # nodes of the session, and their kinds
    CONTROLLER: "torque_controller",
    "demonstration_recorder": "demonstration_recorder",
    "pancake_tracker": "pancake_tracker",
    PLATE: "pancake_tracker",
    "wam_sim": "wam_sim",
    "optitrack_sim": "optitrack_sim",
}
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
    "two nodes of one name": "hardware_sim/test_driver_watch.py::"
    "test_a_second_simulation_is_refused_and_the_first_goes_on",
}


@dataclass
class Session:
    """Stand-ins, controller, recorder and two trackers, with what they say."""

    probe: Probe
    processes: Processes
    diagnostics: list[DiagnosticArray]
    states: list[JointState]
    log: list[Log]

    def parameter(self, node: str, name: str) -> object:
        """`ros2 param get`."""
        request = GetParameters.Request(names=[name])
        (value,) = self.probe.call(GetParameters, f"{node}/get_parameters", request).values
        plain = parameter_value_to_python(value)
        return plain if isinstance(plain, (str, int, float)) else list(plain)

    def set(self, node: str, name: str, value: object) -> str:
        """`ros2 param set`; returns the reason of a refusal, empty if it was set."""
        given: ParameterValue = Value(name, value=value).get_parameter_value()
        request = SetParameters.Request(parameters=[Parameter(name=name, value=given)])
        (result,) = self.probe.call(SetParameters, f"{node}/set_parameters", request).results
        assert result.successful == (self.parameter(node, name) == value)
        return "" if result.successful else result.reason or "refused"

    def change(self, transition: int) -> bool:
        """`ros2 lifecycle set`."""
        return self.probe.change(transition)

    def state(self) -> int:
        """`ros2 lifecycle get`."""
        return self.probe.call(GetState, f"{CONTROLLER}/get_state").current_state.id

    def holds(self) -> None:
        """Wait until the controller holds the arm."""
        status = lambda: diagnosis(self.diagnostics, f"{CONTROLLER}: loop")  # noqa: E731
        self.diagnostics.clear()
        self.probe.until(lambda: status().get("mode") == Mode.HOLD.value, "hold")


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    folder = tmp_path_factory.mktemp("reflexes")
    with private_domain() as domain:
        probe, processes = Probe(domain), Processes(domain, folder)
        diagnostics = probe.diagnostics()
        states = probe.listen(JointState, interface.JOINT_STATES, interface.STATE_RECORD)
        log = probe.listen(Log, interface.LOG, interface.LOG_QOS)
        start = lambda module, *words: processes.start(  # noqa: E731
            [sys.executable, "-m", module, "--ros-args"]
            + [word for file in FILES for word in ("--params-file", file)]
            + [*words]
        )
        # -p for a process with two nodes: one is of the arm, one of the cameras, one of both
        start(
            "hardware_sim.main", "-p", "seed:=3", "-p", "rate:=100.0", "-p", "urdf:=urdf/wam7.urdf"
        )
        start("wam_power_ros.nodes.torque_controller")
        start("wam_power_ros.nodes.demonstration_recorder", "-p", f"directory:={folder}")
        start(TRACKER)
        plate = ("-p", "body:=plate", "-r", "plate/pose:=cameras/plate", "--log-level", "warn")
        start(TRACKER, "-r", f"__node:={PLATE}", *plate, "-p", "use_sim_time:=false")
        made = Session(probe, processes, diagnostics, states, log)
        try:
            probe.until(lambda: {*OWN} <= {*probe.node.get_node_names()}, "all nodes")
            made.holds()
            yield made
            ends = [processes.end(process) for process, _ in reversed(processes.started)]
            assert ends == [0] * len(ends)
        finally:
            probe.close()
            processes.close()


def names_and_types(session: Session) -> dict[str, list[str]]:
    """`ros2 topic list -t`, which hides those of actions."""
    found = session.probe.node.get_topic_names_and_types()
    return {name: kinds for name, kinds in found if "/_" not in name}


def test_the_reflexes_are_forty_and_every_pointer_leads_to_a_test() -> None:
    own = re.findall(r"^def test_\w+\(session", Path(__file__).read_text(), re.MULTILINE)
    assert len(own) + len(ELSEWHERE) >= 40
    for place in ELSEWHERE.values():
        file, name = place.split("::")
        assert f"def {name}(" in (ROOT / "test" / file).read_text(), place


# Nodes


def test_node_list_has_every_node_once_by_the_name_that_it_was_given(session: Session) -> None:
    names = session.probe.node.get_node_names()
    assert [names.count(name) for name in OWN] == [1] * len(OWN)


def test_node_info_of_a_tracker_has_its_topics_and_their_types(session: Session) -> None:
    node = session.probe.node
    published = dict(node.get_publisher_names_and_types_by_node(PLATE, "/"))
    assert published["/plate/state"] == ["nav_msgs/msg/Odometry"]
    assert published["/rollout/plate"] == ["nav_msgs/msg/Path"]
    read = dict(node.get_subscriber_names_and_types_by_node(PLATE, "/"))
    assert read["/rollout/end_effector"] == ["nav_msgs/msg/Path"]


def test_node_info_of_the_controller_has_its_services_of_std_srvs(session: Session) -> None:
    served = dict(session.probe.node.get_service_names_and_types_by_node(CONTROLLER, "/"))
    assert served["/controller/stop"] == served["/controller/reset"] == ["std_srvs/srv/Trigger"]
    assert served["/controller/gravity_compensation"] == ["std_srvs/srv/SetBool"]


def test_action_list_has_the_types_and_one_server_of_each(session: Session) -> None:
    node = session.probe.node
    actions = dict(get_action_names_and_types(node))
    assert actions["/controller/follow_joint_trajectory"] == [
        "control_msgs/action/FollowJointTrajectory"
    ]
    served = get_action_server_names_and_types_by_node(node, f"{CONTROLLER}_preparation", "/")
    assert {name for name, _ in served} == {
        f"/{name}"
        for name in (
            interface.EXECUTE_POLICY,
            interface.MOVE_TO_START,
            interface.REPLAY_MOVEMENT,
            interface.FOLLOW_TRAJECTORY,
        )
    }


def test_a_name_is_the_same_in_log_diagnostics_and_graph(session: Session) -> None:
    reported = lambda: {s.name.partition(":")[0] for m in session.diagnostics for s in m.status}  # noqa: E731
    known = {*OWN} - {"optitrack_sim"}
    session.probe.until(lambda: known <= reported(), f"diagnostics of {known}")
    assert reported() <= {*OWN}
    logged = lambda: {entry.name for entry in session.log}  # noqa: E731
    session.probe.until(lambda: CONTROLLER in logged(), "the log of the controller")
    assert logged() <= {*OWN, "probe"}


def test_a_log_level_silences_what_is_below_it(session: Session) -> None:
    output = lambda word: next(  # noqa: E731
        text.read_text() for p, text in session.processes.started if word in " ".join(p.args)
    )
    assert "[INFO]" in output("demonstration_recorder")
    assert "[INFO]" not in output(PLATE)


# Topics


def test_topic_list_has_no_text_but_the_robot_description(session: Session) -> None:
    strings = [
        name for name, kinds in names_and_types(session).items() if "std_msgs/msg/String" in kinds
    ]
    assert strings == ["/robot_description"]


def test_topic_echo_shows_states_with_names_positions_and_speeds(session: Session) -> None:
    before = len(session.states)
    message = session.probe.until(lambda: session.states[before:], "a state")[0]
    assert len(message.name) == len(message.position) == len(message.velocity) == 7


def test_topic_hz_is_that_of_the_arm_by_its_stamps(session: Session) -> None:
    before = len(session.states)
    session.probe.until(lambda: len(session.states) > before + 200, "states")
    stamps = {nanoseconds(message.header.stamp) for message in session.states[before:]}
    assert set(np.diff(sorted(stamps))) == {2_000_000}


def test_topic_info_names_the_node_and_its_qos(session: Session) -> None:
    (info,) = session.probe.node.get_publishers_info_by_topic("/joint_states")
    assert (info.node_name, interface.is_reliable(info)) == ("wam_sim", True)


def test_topic_echo_with_the_qos_of_sensors_gets_states_too(session: Session) -> None:
    heard = session.probe.listen(JointState, interface.JOINT_STATES, interface.STATE_IN)
    session.probe.until(lambda: heard, "a state, best effort")


def test_topic_pub_of_a_frame_reaches_the_tracker_by_its_remapped_name(session: Session) -> None:
    heard = session.probe.listen(Odometry, "plate/state", interface.STATE_RECORD)
    frames = session.probe.publisher(PoseStamped, "cameras/plate", QoSProfile(depth=10))
    message = PoseStamped()
    message.pose.orientation.w = 1.0
    place = iter(range(10_000))

    def published() -> bool:
        message.header.stamp = session.probe.node.get_clock().now().to_msg()
        message.pose.position.x = 0.8 + 1e-6 * next(place)  # cameras see no pose twice
        message.pose.position.z = 0.6
        frames.publish(message)
        session.probe.spin(0.01)
        return bool(heard)

    session.probe.until(published, "a state of the plate")
    assert heard[0].header.frame_id == "wam_base"
    assert heard[0].child_frame_id == "plate"


def test_two_trackers_track_two_bodies_side_by_side(session: Session) -> None:
    topics = names_and_types(session)
    assert {"/pancake/state", "/plate/state", "/cameras/plate"} <= topics.keys()
    assert "/plate/pose" not in topics
    pancake = session.probe.listen(Odometry, "pancake/state", interface.STATE_RECORD)
    session.probe.until(lambda: pancake, "a state of the pancake")
    assert pancake[0].child_frame_id == "pancake"


def test_bag_record_of_all_topics_finds_every_type_and_each_topic_has_one(session: Session) -> None:
    for name, kinds in names_and_types(session).items():
        (kind,) = kinds
        package, _, message = kind.split("/")
        assert hasattr(import_module(f"{package}.msg"), message), name


# Parameters


@pytest.mark.parametrize("node", OWN)
def test_param_list_is_what_is_in_the_file_of_its_kind(session: Session, node: str) -> None:
    request = ListParameters.Request()
    found = session.probe.call(ListParameters, f"{node}/list_parameters", request).result.names
    own = overlay.from_files([])[OWN[node]]
    ours = {name for name in found if "." not in name and name != "use_sim_time"}
    assert ours - {"start_type_description_service"} == {*own}


def test_param_given_to_a_process_of_two_nodes_reaches_the_one_that_has_it(
    session: Session,
) -> None:
    assert session.parameter("wam_sim", "seed") == 3
    assert session.parameter("optitrack_sim", "rate") == 100.0
    request = GetParameters.Request(names=["rate"])
    assert not session.probe.call(GetParameters, "wam_sim/get_parameters", request).values


def test_param_describe_says_what_may_be_set_at_rest(session: Session) -> None:
    request = DescribeParameters.Request(names=["speed_max", "rate"])
    asked = session.probe.call(DescribeParameters, "pancake_tracker/describe_parameters", request)
    speed, rate = asked.descriptors
    assert (speed.read_only, rate.read_only) == (False, True)
    assert "at rest" in speed.additional_constraints
    assert "restart the node" in rate.additional_constraints


def test_param_set_of_gates_and_latency_of_a_tracker_at_rest(session: Session) -> None:
    for name, value in (("latency_offset", 0.004), ("speed_max", 9.0), ("noise", 0.002)):
        assert session.set(PLATE, name, value) == ""
    assert session.set(PLATE, "workspace_low", [-2.0, -2.0, -0.5]) == ""


def test_param_set_of_a_gate_beyond_its_range_or_against_another_is_refused(
    session: Session,
) -> None:
    assert session.set(PLATE, "speed_max", 900.0)
    reason = session.set(PLATE, "workspace_low", [-2.0, -2.0, 40.0])
    assert "must be below workspace_high" in reason


def test_param_set_of_what_is_read_at_start_is_refused(session: Session) -> None:
    for node, name, value in (
        (PLATE, "rate", 50.0),
        (CONTROLLER, "guarded_speed_max", 1.9),
        (CONTROLLER, "use_sim_time", False),
    ):
        assert session.set(node, name, value)


def test_param_set_of_the_speed_of_moves_at_rest_and_not_in_a_movement(session: Session) -> None:
    session.holds()
    assert session.set(CONTROLLER, "move_speed", 0.05) == ""
    assert session.set(CONTROLLER, "move_speed", -1.0)
    policy = lift("slow")
    away = policy.q_start + 0.3 * np.eye(7)[3]
    move = session.probe.ask("move_to_start", policy.__class__(**{**vars(policy), "q_start": away}))
    session.probe.until(lambda: move.begun, "the movement")
    assert move.result is None
    assert "mode" in session.set(CONTROLLER, "move_speed", 1.0)
    assert session.probe.call(Trigger, interface.STOP).success
    session.probe.answer(move)
    session.holds()
    assert session.set(CONTROLLER, "move_speed", 1.0) == ""


def test_param_set_of_the_torque_share_goes_down_and_only_while_not_active(
    session: Session,
) -> None:
    assert "not active" in session.set(CONTROLLER, "torque_share", 0.9)
    assert session.change(Transition.TRANSITION_DEACTIVATE)
    assert session.set(CONTROLLER, "torque_share", 0.9) == ""
    assert "only lowered" in session.set(CONTROLLER, "torque_share", 0.95)
    assert session.state() == State.PRIMARY_STATE_INACTIVE
    activate = Transition.TRANSITION_ACTIVATE  # refused until the next state has come
    session.probe.until(lambda: session.change(activate), "activation")
    session.holds()


# Services, actions, life cycle


def test_lifecycle_list_offers_what_the_state_allows(session: Session) -> None:
    assert session.state() == State.PRIMARY_STATE_ACTIVE
    offered = session.probe.call(
        GetAvailableTransitions, f"{CONTROLLER}/get_available_transitions"
    ).available_transitions
    assert {each.transition.label for each in offered} >= {"deactivate", "shutdown"}


def test_lifecycle_set_deactivates_and_activates_and_torques_follow(session: Session) -> None:
    assert session.change(Transition.TRANSITION_DEACTIVATE)
    assert session.state() == State.PRIMARY_STATE_INACTIVE
    refused = session.probe.answer(session.probe.ask("move_to_start", lift("none")))
    assert refused.code is Code.NOT_ACTIVE
    assert session.change(Transition.TRANSITION_ACTIVATE)
    session.holds()


def test_service_call_of_stop_at_rest_says_that_it_is_done(session: Session) -> None:
    assert session.probe.call(Trigger, "/controller/stop").success


def test_action_send_goal_with_feedback_passes_waypoints(session: Session) -> None:
    session.holds()
    q = np.array(session.states[-1].position)
    movement = joint_messages.JointMovement(np.array([0.0, 0.5]), np.array([q, q + 0.05]))
    trajectory = joint_messages.movement_message(list(session.states[-1].name), movement)
    sent = session.probe.ask("follow", trajectory=trajectory)
    session.probe.until(lambda: sent.result, "the end of the goal")
    assert sent.status == GoalStatus.STATUS_SUCCEEDED
    assert sent.result.error_code == FollowJointTrajectory.Result.SUCCESSFUL


def test_service_call_of_the_recorder_names_the_bag_and_a_second_end_is_refused(
    session: Session,
) -> None:
    record = lambda on: session.probe.call(SetBool, interface.RECORD, SetBool.Request(data=on))  # noqa: E731
    assert record(True).success
    session.probe.spin(0.5)
    bag = record(False)
    assert bag.success and Path(bag.message.split()[-1].rstrip(".")).parent.exists()
    assert not record(False).success
