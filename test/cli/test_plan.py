# SPDX-License-Identifier: Apache-2.0
"""The plan that `wam-power plan` prints; test/system runs the launch files that start it."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT

from wam_power_ros.cli import main
from wam_power_ros.cli.launcher import Devices, folder_lock
from wam_power_ros.cli.plan import DOMAIN_FILE, LEARNER, TRACKER, plan_of
from wam_power_ros.cli.plan_command import arm_description
from wam_power_ros.params import overlay
from wam_power_ros.params.parameter_file import of_nodes
from wam_power_ros.ros.domain import HELD

BAGS = sorted((ROOT / "bags").glob("demo_*"))
BARE = """
import importlib.util, json, sys
missing = ("pydantic", "numpy", "yaml", "launch", "wam_power_ros")
assert [name for name in missing if importlib.util.find_spec(name)] == []
sys.path.insert(0, sys.argv[1])
import wam_power_plan
print(json.dumps(wam_power_plan.plan(sys.argv[2], json.loads(sys.argv[3]))))
"""
Printed = Callable[..., dict[str, Any]]
FRAMES = ["robot_state_publisher", "static_transform_publisher"]


@pytest.fixture(autouse=True)
def own_locks(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Locks of domains that other tests on this machine do not see."""
    folder = tmp_path_factory.mktemp("locks")
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))


@pytest.fixture
def printed(capsys: pytest.CaptureFixture[str]) -> Printed:
    """Function that returns the plan that a command prints."""

    def plan(*words: object) -> dict[str, Any]:
        assert main.main(["plan", *map(str, words)]) == 0
        return dict(json.loads(capsys.readouterr().out))

    return plan


def names(plan: dict[str, Any]) -> list[str]:
    return [process["name"] for process in plan["processes"]]


def parameters(plan: dict[str, Any], folder: Path) -> overlay.Setup:
    (text,) = (text for file, text in plan["files"].items() if file.endswith("parameters.yaml"))
    file = folder / "read.yaml"
    file.write_text(text)
    return of_nodes(file)


def test_hardware_starts_no_stand_in_and_no_torque_without_activation(
    printed: Printed, refusal: Callable[..., str], tmp_path: Path
) -> None:
    plan = printed("hardware", "--config", "geodude", "--config", "full_speed")
    assert names(plan) == ["torque_controller", "demonstration_recorder", "pancake_tracker"]
    assert plan["check"] == []
    controller = parameters(plan, tmp_path)["torque_controller"]
    assert not controller["autostart"]
    assert controller["joint_names"][0] == "right_j1"
    folder = tmp_path / "s"
    plan = printed("hardware", "--config", "geodude", "--session", folder, "--bags", BAGS[0])
    assert names(plan)[-1] == "learner"
    assert not parameters(plan, tmp_path)["learner"]["reset_faults"]
    assert "config is empty" in refusal("plan", "hardware")


@pytest.mark.parametrize(
    ("words", "pace"),
    [
        ([], "lockstep"),
        (["--pace", "real_time"], "real_time"),
        (["--config", "libbarrett"], "real_time"),
    ],
)
def test_stand_ins_keep_the_pace_that_was_asked_for(
    words: list[str], pace: str, printed: Printed, tmp_path: Path
) -> None:
    plan = printed("sim", *words)
    assert set(names(plan)) == set(overlay.NODES) - {"optitrack_sim", "learner"}
    assert plan["check"][2] == "hardware_sim.driver_watch"
    given = parameters(plan, tmp_path)
    assert given["wam_sim"]["pace"] == pace
    assert given["learner"].get("use_sim_time", False) == (pace == "lockstep")


def test_a_session_has_its_bags_in_its_folder_and_the_given_settings(
    printed: Printed, tmp_path: Path
) -> None:
    folder = tmp_path / "s"
    given = {"seed": 7, "trials": 20, "minutes": 90, "learner": "cma_es", "preset": "paper"}
    words = [word for name, value in given.items() for word in (f"--{name}", value)]
    plan = printed("sim", "--session", folder, "--bags", BAGS[0], BAGS[1], *words)
    nodes = parameters(plan, tmp_path)
    assert {name: nodes["learner"][name] for name in given} == given
    assert nodes["learner"]["demonstrations"] == [str(bag) for bag in BAGS[:2]]
    assert nodes["learner"]["session"] == str(folder)
    assert nodes["demonstration_recorder"]["directory"] == str(folder / "bags")
    assert nodes["wam_sim"]["seed"] == 7
    assert plan["files"][str(folder / "logs" / DOMAIN_FILE)] == ""
    assert [str(folder / "logs" / ".lock"), False] in plan["locks"]
    assert plan["processes"][-1]["then"][-2:] == ["report", str(folder)]
    assert not folder.exists()


@pytest.mark.parametrize("attended", [True, False])
def test_the_loss_of_a_recorder_ends_a_session_only_beside_a_person(
    attended: bool, tmp_path: Path
) -> None:
    setup, nodes = Devices().parameters("flip"), (TRACKER, LEARNER)
    plan = plan_of(tmp_path, setup, stand_ins=True, also=nodes, attended=attended)
    restarted = {process.name for process in plan.processes if process.respawn}
    optional = {process.name for process in plan.processes if not process.required}
    assert restarted == optional
    assert restarted == (set() if attended else {"demonstration_recorder", "pancake_tracker"})


def test_each_node_of_a_namespace_has_its_clock_and_its_enclave(printed: Printed) -> None:
    plan = printed("sim", "--namespace", "/left/", "--secure")
    for process in plan["processes"]:
        words = process["command"]
        assert "__ns:=/left" in words and "/clock:=/left/clock" in words
        assert words[-2:] == ["--enclave", f"/left/{process['name']}"]
    assert plan["environment"]["ROS_SECURITY_ENABLE"] == "true"
    assert [shared for _, shared in plan["locks"]] == [True, False, False]
    assert plan["environment"][HELD] == plan["environment"]["ROS_DOMAIN_ID"]  # by the launch


def test_a_plan_refuses_a_session_in_use_and_changes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with folder_lock(tmp_path):
        assert main.main(["plan", "sim", "--session", str(tmp_path)]) == 2
    assert "another session or learner is using" in capsys.readouterr().err
    assert {path.name for path in (tmp_path / "logs").iterdir()} == {".lock"}


def test_a_task_without_a_body_has_no_tracker(printed: Printed, tmp_path: Path) -> None:
    for kind in ("sim", "hardware"):
        plan = printed(kind, "--task", "reach", "--config", "geodude", "--session", tmp_path / "s")
        assert "pancake_tracker" not in names(plan)
        assert parameters(plan, tmp_path)["learner"]["task"] == "reach"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--task", "flop"], "'flop' is not one of"),
        (["--learner", "luck"], "'luck'"),
        (["--namespace", "le ft"], "names of letters, digits and underscores"),
        (["--trials", "5", "--bags", BAGS[0], "--task", "reach"], "demonstration of flip"),
    ],
)
def test_a_wrong_option_is_refused_before_anything_is_written(
    words: list[object], says: str, refusal: Callable[..., str]
) -> None:
    assert says in refusal("plan", "sim", "--session", "s", *map(str, words))


def test_the_description_of_the_arm_has_the_frames_and_the_clock_of_its_nodes() -> None:
    def of(devices: Devices, namespace: str = "") -> dict[str, object] | None:
        setup = devices.parameters()
        return arm_description(plan_of(Path(), setup, stand_ins=True, namespace=namespace))

    described = of(Devices(), "/left")
    assert described is not None
    assert described["frame_prefix"] == "left/" and described["use_sim_time"] is True
    assert '<link name="wam_base">' in str(described["robot_description"])
    alone = of(Devices(simulate=True))
    assert alone is not None
    assert (alone["frame_prefix"], alone["use_sim_time"]) == ("", False)
    assert of(Devices(["geodude"], simulate=True)) is None  # other names than its URDF's


def install(prefix: Path, *programs: str) -> None:
    """Empty executables, named PACKAGE/NAME."""
    for name in programs:
        (program := prefix / "lib" / name).parent.mkdir(parents=True)
        program.touch()


def test_rviz_and_the_state_publisher_are_found_in_the_sourced_workspaces(
    printed: Printed,
    refusal: Callable[..., str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    assert "rviz2 is not installed" in refusal("plan", "sim", "--rviz")
    install(
        tmp_path / "prefix",
        "robot_state_publisher/robot_state_publisher",
        "tf2_ros/static_transform_publisher",
        "rviz2/rviz2",
    )
    plan = printed("sim", "--rviz", "--namespace", "left")
    shown = [process for process in plan["processes"] if process["name"] not in overlay.NODES]
    state_publisher, frames, rviz = shown
    assert [process["name"] for process in shown] == [*FRAMES, "rviz2"]
    for process in shown:
        assert not process["required"] and not process["respawn"]
        assert "__ns:=/left" in process["command"]
    for process in (state_publisher, rviz):
        assert any(word in plan["files"] for word in process["command"])
    assert {"--frame-id=world", "--child-frame-id=left/wam_base"} <= set(frames["command"])
    without = printed("sim", "--task", "reach")  # no cameras
    assert "static_transform_publisher" not in names(without)


def test_on_hardware_the_frames_are_published_if_that_is_asked_for(
    printed: Printed,
    refusal: Callable[..., str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    wanted = ("hardware", "--config", "ur", "--config", "natnet_ros2", "--tf")
    assert "robot_state_publisher is not installed" in refusal("plan", *wanted)
    install(tmp_path / "prefix", "robot_state_publisher/robot_state_publisher")
    assert "static_transform_publisher is not installed" in refusal("plan", *wanted)
    install(tmp_path / "prefix", "tf2_ros/static_transform_publisher")
    moved = tmp_path / "moved.yaml"
    pose = "world_to_base: [1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 0.0]"  # turned by half a turn about z
    moved.write_text(f"pancake_tracker: {{ros__parameters: {{{pose}}}}}")
    plan = printed(*wanted, "--config", moved)
    command = next(each for each in plan["processes"] if each["name"] == FRAMES[1])["command"]
    given = dict(word[2:].split("=") for word in command if word.startswith("--") and "=" in word)
    assert given.pop("frame-id") == "world" and given.pop("child-frame-id") == "base_link"
    found = {name: float(value) for name, value in given.items()}
    assert found == pytest.approx({"x": 1, "y": 2, "z": -3, "qx": 0, "qy": 0, "qz": 1, "qw": 0})
    assert not {*FRAMES} & set(names(printed(*wanted[:-1])))
    why = "robot_state_publisher needs a URDF with the joint names of the driver"
    assert why in refusal("plan", "hardware", "--config", "geodude", "--tf")


# The launch files


def bare_plan(folder: Path, kind: str, **given: object) -> subprocess.CompletedProcess[str]:
    """Plan of launch arguments, made in a Python that has the standard library alone."""
    values = {"demonstrations": "", "config": "", "secure": "false", "rviz": "false", "tf": "false"}
    values |= {name: str(value) for name, value in given.items()}
    words = [str(folder), kind, json.dumps(values)]
    return subprocess.run(
        [sys.executable, "-I", "-S", "-c", BARE, *words],
        cwd=folder,
        env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
        capture_output=True,
        text=True,
    )


def test_a_launch_file_gets_its_plan_in_a_python_with_the_standard_library_alone(
    installation: Path, printed: Printed, tmp_path: Path
) -> None:
    bag = tmp_path / "my bags" / BAGS[0].name
    bag.parent.mkdir()
    bag.symlink_to(BAGS[0])
    given = {"namespace": "left", "seed": 7, "session": tmp_path / "s", "secure": "true"}
    made = bare_plan(
        installation, "sim", **given, config="geodude", demonstrations=f"'{bag}' {BAGS[1]}"
    )
    assert made.returncode == 0, made.stderr
    words = ["--namespace", "left", "--seed", 7, "--session", tmp_path / "s", "--secure"]
    expected = printed("sim", *words, "--config", "geodude", "--bags", bag, BAGS[1])
    assert json.loads(made.stdout) == expected
    assert not any(Path(tempfile.gettempdir()).glob("wam_power_ros_*"))


@pytest.mark.parametrize(
    ("kind", "given", "says"),
    [
        ("sim", {"trials": "few"}, "'few' is not a whole number"),
        ("sim", {"seed": "-1"}, "-1 must be at least 0"),
        ("sim", {"demonstrations": "'unended"}, "No closing quotation"),
        ("hardware", {"config": " "}, "config is empty"),
    ],
)
def test_a_wrong_launch_argument_is_refused_in_words(
    kind: str, given: dict[str, object], says: str, installation: Path
) -> None:
    made = bare_plan(installation, kind, **given)
    assert made.returncode == 1
    assert says in made.stderr


def test_a_launch_file_imports_nothing_but_the_standard_library_and_launch() -> None:
    for path in (ROOT / "launch").glob("*.py"):
        found = {
            (name or "").partition(".")[0]
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, (ast.Import, ast.ImportFrom))
            for name in (
                [node.module]
                if isinstance(node, ast.ImportFrom)
                else [alias.name for alias in node.names]
            )
        }
        beyond = found - set(sys.stdlib_module_names) - {"launch", "yaml", "wam_power_plan"}
        assert beyond == set(), path.name
