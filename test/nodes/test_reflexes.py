# SPDX-License-Identifier: Apache-2.0
"""What a ROS engineer types without reading, in one session of real nodes, in lockstep.

`ros2` is not among the wheels: what it asks a graph is asked here.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from conftest import ROOT, Probe, Processes, diagnosis
from control_msgs.action import FollowJointTrajectory
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Log, Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter as Value
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from wam_power_ros.control.modes import Mode
from wam_power_ros.params import overlay
from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.ros.domain import private_domain

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


@dataclass
class Session:
    """Stand-ins, controller, recorder and two trackers, with what they say."""

    probe: Probe
    diagnostics: list[DiagnosticArray]
    states: list[JointState]
    log: list[Log]

    def parameter(self, node: str, name: str) -> object:
        """`ros2 param get`; None if the node does not have it."""
        request = GetParameters.Request(names=[name])
        values = self.probe.call(GetParameters, f"{node}/get_parameters", request).values
        return parameter_value_to_python(values[0]) if values else None


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    folder = tmp_path_factory.mktemp("reflexes")
    with private_domain() as domain:
        probe, processes = Probe(domain), Processes(domain, folder)
        diagnostics = probe.listen(
            DiagnosticArray, interface.DIAGNOSTICS, interface.DIAGNOSTICS_QOS
        )
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
        plate = ("-p", "body:=plate", "-r", "plate/pose:=cameras/plate")
        start(TRACKER, "-r", f"__node:={PLATE}", *plate, "-p", "use_sim_time:=false")
        try:
            probe.until(lambda: {*OWN} <= {*probe.node.get_node_names()}, "all nodes")
            status = lambda: diagnosis(diagnostics, f"{CONTROLLER}: loop")  # noqa: E731
            probe.until(lambda: status().get("mode") == Mode.HOLD.value, "hold")
            yield Session(probe, diagnostics, states, log)
            ends = [processes.end(process) for process, _ in reversed(processes.started)]
            assert ends == [0] * len(ends)
        finally:
            probe.close()
            processes.close()


def test_a_name_is_the_same_in_log_diagnostics_and_graph(session: Session) -> None:
    names = session.probe.node.get_node_names()
    assert [names.count(name) for name in OWN] == [1] * len(OWN)
    reported = lambda: {s.name.partition(":")[0] for m in session.diagnostics for s in m.status}  # noqa: E731
    known = {*OWN} - {"optitrack_sim"}
    session.probe.until(lambda: known <= reported(), f"diagnostics of {known}")
    assert reported() <= {*OWN}
    logged = lambda: {entry.name for entry in session.log}  # noqa: E731
    session.probe.until(lambda: CONTROLLER in logged(), "the log of the controller")
    assert logged() <= {*OWN, "probe"}


def test_a_second_tracker_has_the_topics_of_its_body_by_their_remapped_names(
    session: Session,
) -> None:
    heard = session.probe.listen(Odometry, "plate/state", interface.STATE_RECORD)
    pancake = session.probe.listen(Odometry, "pancake/state", interface.STATE_RECORD)
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
        return bool(heard and pancake)

    session.probe.until(published, "states of both bodies")
    assert heard[0].header.frame_id == "wam_base"
    assert (heard[0].child_frame_id, pancake[0].child_frame_id) == ("plate", "pancake")


def test_every_topic_has_one_type_that_is_there_and_none_is_text_but_the_description(
    session: Session,
) -> None:
    found = session.probe.node.get_topic_names_and_types()
    topics = {name: kinds for name, kinds in found if "/_" not in name}  # not those of actions
    strings = [name for name, kinds in topics.items() if "std_msgs/msg/String" in kinds]
    assert strings == ["/robot_description"]
    assert "/plate/pose" not in topics
    for name, (kind,) in topics.items():
        package, _, message = kind.split("/")
        assert hasattr(import_module(f"{package}.msg"), message), name


def test_param_list_is_what_is_in_the_file_of_its_kind(session: Session) -> None:
    for node, kind in OWN.items():
        request = ListParameters.Request()
        found = session.probe.call(ListParameters, f"{node}/list_parameters", request).result.names
        ours = {name for name in found if "." not in name and name != "use_sim_time"}
        assert ours - {"start_type_description_service"} == {*overlay.of_files([])[kind]}


def test_param_given_to_a_process_of_two_nodes_reaches_the_one_that_has_it(
    session: Session,
) -> None:
    assert session.parameter("wam_sim", "seed") == 3
    assert session.parameter("optitrack_sim", "rate") == 100.0
    assert session.parameter("wam_sim", "rate") is None


def test_param_set_is_refused_with_what_to_do_instead(session: Session) -> None:
    for node, name, value in (
        (PLATE, "rate", 50.0),
        (CONTROLLER, "elbow_speed_max", 1.9),
        (CONTROLLER, "use_sim_time", False),
    ):
        given: ParameterValue = Value(name, value=value).get_parameter_value()
        request = SetParameters.Request(parameters=[Parameter(name=name, value=given)])
        (result,) = session.probe.call(SetParameters, f"{node}/set_parameters", request).results
        assert not result.successful and "restart the node" in result.reason
        assert session.parameter(node, name) != value


def test_action_send_goal_with_feedback_passes_waypoints(session: Session) -> None:
    q = np.array(session.states[-1].position)
    movement = joint_messages.JointMovement(np.array([0.0, 2.0]), np.array([q, q + 0.05]))
    trajectory = joint_messages.movement_message(list(session.states[-1].name), movement)
    sent = session.probe.ask("follow", trajectory=trajectory)
    session.probe.until(lambda: sent.result, "the end of the goal")
    assert sent.status == GoalStatus.STATUS_SUCCEEDED
    assert sent.result.error_code == FollowJointTrajectory.Result.SUCCESSFUL
