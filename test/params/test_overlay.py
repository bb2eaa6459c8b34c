# SPDX-License-Identifier: Apache-2.0
"""Set-ups: each parameter is given once, overridden in order, and reaches every node."""

from __future__ import annotations

from pathlib import Path

import pinocchio as pin
import pytest
from all_params import READS
from conftest import ROOT

from hardware_sim.settings import ArmSimParams
from wam_power_ros import installed
from wam_power_ros.cli import main
from wam_power_ros.params import overlay, parameter_file
from wam_power_ros.params.node_params import Params
from wam_power_ros.params.resources import robot_description
from wam_power_ros.params.torque_controller_params import TorqueControllerParams


def read(setup: overlay.Setup, node: str, folder: Path) -> Params:
    """Parameters of a node, read as the node reads them."""
    file = folder / "parameters.yaml"
    file.write_text(overlay.text(setup))
    return READS[node].from_setup(overlay.from_files([file]))


def write(folder: Path, name: str, text: str) -> str:
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return str(path)


def test_set_ups_have_parameters_for_the_existing_nodes() -> None:
    # Without parameters of their own: one reads set-ups, one asks the running controller, and one
    # is the same node as the pancake_tracker.
    executables = set(main.NODES) - {"check_driver", "replay", "body_tracker"}
    assert set(overlay.NODES) == executables | {"optitrack_sim"} == set(READS)


@pytest.mark.parametrize("name", overlay.known())
@pytest.mark.parametrize("simulated", [False, True])
def test_every_set_up_is_accepted_by_every_node(name: str, simulated: bool, tmp_path: Path) -> None:
    (tmp_path / "parameters.yaml").write_text(overlay.text(overlay.setup([name], simulated)))
    setup = overlay.from_files([tmp_path / "parameters.yaml"])
    params = {node: READS[node].from_setup(setup) for node in overlay.NODES}
    arm, learner = params["torque_controller"], params["learner"]
    # parameters that several nodes share are equal
    assert arm.joint_names == learner.joint_names == params["demonstration_recorder"].joint_names
    assert arm.joint_names == params["wam_sim"].joint_names
    assert (arm.urdf, arm.tool_frame) == (learner.urdf, learner.tool_frame)
    assert arm.command_topic in params["demonstration_recorder"].driver_topics
    # the learner simulates policies with the limits of the controller
    files = [ROOT / file for file in learner.controller]
    limits = TorqueControllerParams.from_setup(overlay.from_files(files))
    lab = ["simulation", "hold_to_run", "allow_no_realtime"]
    if (
        params["wam_sim"].pace == "lockstep"
    ):  # nobody stands beside the arm: it moves to a start faster
        lab += ["move_speed", "realtime_priority"]
    of_the_lab = {name: getattr(arm, name) for name in lab}
    assert limits.model_copy(update=of_the_lab) == arm
    assert learner.scene_reset == (simulated and name != "unattended")
    assert learner.reset_faults == simulated
    assert arm.simulation == simulated
    assert arm.hold_to_run == (not arm.allow_no_realtime) == (not simulated)
    assert params["demonstration_recorder"].source == ("sim" if simulated else "hardware")


def test_without_a_set_up_every_node_has_the_parameters_of_its_own_file_in_simulation() -> None:
    setup = overlay.setup()
    for node in overlay.NODES:
        own = dict(parameter_file.of_nodes(ROOT / f"config/{node}.yaml")[node])
        own |= parameter_file.of_nodes(ROOT / "config/simulation.yaml").get(node, {})
        if node == "learner":
            own["controller"] = [*own["controller"], "config/simulation.yaml"]
        own |= parameter_file.of_nodes(ROOT / "config/lockstep.yaml").get(node, {})
        assert {name: setup[node][name] for name in own} == own
        assert setup[node].get("use_sim_time", False) == (node not in overlay.STAND_INS)


def test_parameters_derived_from_a_driver_reach_recorder_and_stand_in(tmp_path: Path) -> None:
    setup = overlay.setup(["libbarrett"], simulated=True)
    recorder = read(setup, "demonstration_recorder", tmp_path)
    assert recorder.driver_topics == ("joint_torque_commands", "wam/jointVelocity")
    assert recorder.joint_names[0] == setup["wam_sim"]["joint_names"][0] == "q1"
    assert setup["wam_sim"]["pace"] == "real_time"
    assert setup["wam_sim"]["driver_compensates_gravity"]


@pytest.mark.parametrize("name", overlay.known())
def test_what_a_node_shows_is_in_the_frame_of_the_arm_of_the_set_up(name: str) -> None:
    setup = overlay.setup([name], simulated=True)
    arm = setup["torque_controller"]
    for node in ("pancake_tracker", "learner"):
        assert setup[node]["base_frame"] == arm["base_frame"]
    root = pin.buildModelFromXML(robot_description(arm["urdf"])).frames[1].name
    assert arm["base_frame"] == root  # where robot_state_publisher begins


@pytest.mark.parametrize(
    ("driver", "poses"),
    [
        ("natnet_ros2", "ball/pose"),
        ("vrpn_mocap", "vrpn_mocap/ball/pose"),
        ("motion_capture_tracking", ""),
    ],
)
def test_the_name_of_the_body_is_given_once_and_inserted_into_the_drivers_topic(
    driver: str, poses: str, tmp_path: Path
) -> None:
    ball = write(tmp_path, "ball", "pancake_tracker: {ros__parameters: {body: ball}}")
    setup = overlay.setup([driver, ball], simulated=True)
    assert setup["pancake_tracker"]["pose_topic"] == setup["optitrack_sim"]["pose_topic"] == poses
    seen = poses or setup["pancake_tracker"]["markers_topic"]
    assert setup["demonstration_recorder"]["mocap_topics"] == [seen]
    for node in ("demonstration_recorder", "optitrack_sim"):
        assert setup[node]["body"] == "ball"
    none = write(tmp_path, "none", 'pancake_tracker: {ros__parameters: {body: ""}}')
    recorder = overlay.setup([driver, none])["demonstration_recorder"]
    assert (recorder["body"], recorder["mocap_topics"]) == ("", [""])  # how ROS has no topic


def test_the_source_of_a_later_file_replaces_that_of_a_file_before(tmp_path: Path) -> None:
    cloud = write(tmp_path, "cloud", "pancake_tracker: {ros__parameters: {markers_topic: cloud}}")
    for names, pose, markers in (
        (["natnet_ros2", cloud], "", "cloud"),
        ([cloud, "natnet_ros2"], "pancake/pose", ""),
    ):
        tracker = overlay.setup(names)["pancake_tracker"]
        assert (tracker["pose_topic"], tracker["markers_topic"]) == (pose, markers)
    ball = overlay.setup(["natnet_ros2"], task="ball_in_cup")["pancake_tracker"]
    assert (ball["pose_topic"], ball["markers_topic"]) == ("ball/pose", "")
    tracker = {"pose_topic": "", "markers_topic": "cloud", "mocap_frame": "world"}
    wrong = {"message_type": "nav_msgs/msg/Odometry"}
    setup = overlay.setup(["natnet_ros2"]).changed({"pancake_tracker": tracker | wrong})
    with pytest.raises(ValueError, match=r"'nav_msgs/msg/Odometry' is not one of markers_topic"):
        read(setup, "pancake_tracker", tmp_path)
    index = {"message_type": "geometry_msgs/msg/PoseArray", "body_in_message": "first"}
    setup = overlay.setup(["natnet_ros2"]).changed({"pancake_tracker": index})
    with pytest.raises(ValueError, match=r"'first' must be the index of the pose"):
        read(setup, "pancake_tracker", tmp_path)


@pytest.mark.parametrize("names", [(), ("natnet_ros2",)])
def test_a_tasks_own_tool_and_cameras_reach_the_stand_ins_too(
    names: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cup.urdf").write_text("<robot/>")
    own = "urdf: cup.urdf, tool_frame: cup, guarded_region: %s"
    arm = "torque_controller: {ros__parameters: {" + own + "}}"
    ball = "pancake_tracker: {ros__parameters: {body: ball, single_marker: true, noise: 0.001}}"
    obstacle = [0.5, 0.0, 0.5, 0.1]
    file = Path(write(tmp_path, "carry", f"{arm % obstacle}\n{ball}"))
    monkeypatch.setattr(installed, "task_setup", lambda task, own: file)
    setup = overlay.setup(names, simulated=bool(names), task="ball_in_cup")
    for node in ("torque_controller", "wam_sim", "learner", "demonstration_recorder"):
        tool = {"urdf": str(tmp_path / "cup.urdf"), "tool_frame": "cup"}
        assert tool.items() <= setup[node].items()
    assert setup["wam_sim"]["guarded_region"] == obstacle
    assert {"body": "ball", "single_marker": True}.items() <= setup["optitrack_sim"].items()
    assert setup["wam_sim"]["pace"] == ("real_time" if names else "lockstep")


def test_a_set_up_is_a_value_that_reads_back_as_it_was_written(tmp_path: Path) -> None:
    setup = overlay.setup(["cobot"], simulated=True, task="reach")
    other = setup.changed({"wam_sim": {"seed": 5}})
    assert (setup["wam_sim"]["seed"], other["wam_sim"]["seed"]) == (0, 5)
    assert other.changed({"wam_sim": {"seed": 0}}) == setup != other
    file = tmp_path / "parameters.yaml"
    file.write_text(overlay.text(other))
    assert overlay.read(file) == parameter_file.of_nodes(file) == other
    file.write_text("wam_sim: {ros__parameters: {seed: 7}}")  # of an older version: fewer values
    assert ArmSimParams.from_setup(overlay.read(file)).seed == 7


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("torque_controler: {ros__parameters: {}}", "torque_controler"),
        ("torque_controller: {ros__parameters: {joint_name: [a]}}", "is it joint_names"),
        ("torque_controller: 5", "torque_controller is 5; allowed are names with values"),
        ("a/one: {ros__parameters: {}}\nb/one: {ros__parameters: {}}", "one twice"),
        ("- a\n- b", r"the file is \['a', 'b'\]; allowed are names with values"),
        ("torque_controller: !!python/object:os.system {}", "not plain YAML"),
        ("torque_controller: {ros__parameters: {joint_names: [a, 2]}}", r"one like \['wam"),
        ("torque_controller: {ros__parameters: {period: true}}", "is True; allowed is one like 0"),
        ("learner: {ros__parameters: {trials: 2.5}}", "2.5; allowed is one like 0"),
        (f"learner: {{ros__parameters: {{seed: 1{400 * '0'}}}}}", "seed is no finite number"),
    ],
)
def test_a_bad_file_is_refused_by_name(text: str, says: str, tmp_path: Path) -> None:
    path = write(tmp_path, "bad", text)
    with pytest.raises(ValueError, match=says) as refused:
        overlay.setup([path])
    assert path in str(refused.value)


PAIRS = [("geodude", "natnet_ros2"), ("cobot", "libbarrett"), ("reach", "franka", "full_speed")]


@pytest.mark.requirement("S-101")
@pytest.mark.parametrize("names", [*((name,) for name in overlay.known()), *PAIRS], ids="+".join)
def test_plain_files_say_to_a_node_what_the_set_ups_say(names: tuple[str, ...]) -> None:
    files = [ROOT / f"config/{name}.yaml" for name in ("learner", *names)]
    plain, setup = overlay.from_files(files), overlay.setup(names)
    for node in {*overlay.NODES} - {*overlay.STAND_INS}:
        assert plain[node] == setup[node]


def test_a_section_of_all_nodes_reaches_each_that_has_the_parameter(tmp_path: Path) -> None:
    common = "/**: {ros__parameters: {rate: 100.0, command_topic: torques, urdf: my.urdf}}"
    (tmp_path / "my.urdf").write_text("<robot/>")
    file = Path(write(tmp_path, "lab", common))
    for setup in (overlay.from_files([file], "/left"), overlay.setup([str(file)], simulated=True)):
        assert setup["pancake_tracker"]["rate"] == setup["optitrack_sim"]["rate"] == 100.0
        assert setup["wam_sim"]["command_topic"] == "torques"
        assert setup["demonstration_recorder"]["driver_topics"] == ["torques"]
        assert setup["demonstration_recorder"]["urdf"] == str(tmp_path / "my.urdf")
        assert setup["learner"]["controller"][-1] == str(file)
        assert "rate" not in setup["learner"]
    write(tmp_path, "lab", "/**: {ros__parameters: {raet: 100.0}}")
    with pytest.raises(ValueError, match="every node has no parameter 'raet'; is it rate"):
        overlay.from_files([file])


@pytest.mark.requirement("S-101")
def test_plain_files_of_another_namespace_say_nothing_and_complete_ones_nothing_new(
    tmp_path: Path,
) -> None:
    joints = lambda file, namespace="/": overlay.from_files([file], namespace)[  # noqa: E731
        "demonstration_recorder"
    ]["joint_names"]
    arms = "{left: %s, right: %s}"
    arm = "{torque_controller: {ros__parameters: {joint_names: [%s]}}}"
    file = Path(write(tmp_path, "arms", arms % (arm % "l1", arm % "r1")))
    assert joints(file, "/left") == ["l1"]
    assert joints(file) == overlay.from_files([])["demonstration_recorder"]["joint_names"]
    both = "/**/torque_controller: {ros__parameters: {joint_names: [a]}}\n/left: " + arm % "l1"
    file = Path(write(tmp_path, "both", both))
    for namespace, joint in (("/left", "l1"), ("/right", "a"), ("/", "a")):
        assert joints(file, namespace) == [joint]
    complete = tmp_path / "complete.yaml"
    for setup in (overlay.setup(), overlay.setup(["libbarrett", "reach"])):
        complete.write_text(overlay.text(setup))
        assert overlay.from_files([complete]) == setup


@pytest.mark.requirement("S-101")
def test_no_set_up_makes_a_simulation_of_an_arm_or_lets_its_controller_start_itself(
    tmp_path: Path,
) -> None:
    section = "torque_controller: {ros__parameters: {%s: true}}"
    simulation = write(tmp_path, "simulation", section % "simulation")
    with pytest.raises(ValueError, match=r"simulation: true in the set-ups .* --simulate"):
        overlay.setup(["geodude", simulation])
    assert overlay.setup(["geodude", simulation], simulated=True)["learner"]["reset_faults"]
    with pytest.raises(ValueError, match=r"no set-up 'simulation'.*geodude.*libbarrett"):
        overlay.setup(["geodude", "simulation"])
    itself = overlay.setup(["geodude", write(tmp_path, "itself", section % "autostart")])
    with pytest.raises(ValueError, match="autostart = True: must be false on a real arm"):
        read(itself, "torque_controller", tmp_path)
    for name in overlay.known():
        assert not overlay.setup([name])["torque_controller"]["autostart"]


def test_what_an_arm_needs_for_a_task_is_beside_its_set_up(tmp_path: Path) -> None:
    section = "torque_controller: {ros__parameters: {tool_speed_max: %s}}"
    arm = write(tmp_path, "arm", section % 1.0)
    write(tmp_path, "arm.reach", section % 2.0)
    limit = lambda *names, task="": overlay.setup(names, task=task)["torque_controller"]  # noqa: E731
    assert limit(arm)["tool_speed_max"] == limit(arm, task="flip")["tool_speed_max"] == 1.0
    assert limit(arm, task="reach")["tool_speed_max"] == 2.0
    later = write(tmp_path, "later", section % 3.0)
    assert limit(arm, later, task="reach")["tool_speed_max"] == 3.0
    assert limit("openarm", task="reach")["guarded_region"][3] == 0.054
    assert "openarm.reach" not in overlay.known()
    files = overlay.setup([arm], task="reach")["learner"]["controller"]
    assert files[-1].endswith("arm.reach.yaml")
