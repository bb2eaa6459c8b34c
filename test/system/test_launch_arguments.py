# SPDX-License-Identifier: Apache-2.0
"""What the launch files give to the nodes, without `launch`, which is not among the wheels."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import yaml
from conftest import ROOT

from wam_power_ros.params import overlay

MODULES = {
    "launch": ("LaunchContext", "LaunchDescription"),
    "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction", "Shutdown"),
    "launch.events.process": ("ProcessExited",),
    "launch.substitutions": ("LaunchConfiguration",),
    "launch_ros.actions": ("Node",),
}


@pytest.fixture
def file(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Names in hardware.launch.py, whose actions are their arguments."""

    class Action(SimpleNamespace):
        def __init__(self, *name: object, **given: object) -> None:
            super().__init__(name=name, **given)

    for module, names in MODULES.items():
        made = ModuleType(module)
        vars(made).update(dict.fromkeys(names, Action))
        monkeypatch.setitem(sys.modules, module, made)
    return runpy.run_path(str(ROOT / "launch/hardware.launch.py"))


def launched(file: dict[str, Any], **given: str) -> dict[str, Any]:
    """Nodes by name that are started for launch arguments."""
    values = {name: default for name, (default, _) in file["ARGUMENTS"].items()} | given
    configuration = lambda name: SimpleNamespace(perform=lambda _: values[name])  # noqa: E731
    file["nodes"].__globals__["LaunchConfiguration"] = configuration
    return {node.executable: node for node in file["nodes"](None)}


def setup(nodes: dict[str, Any], folder: Path) -> dict[str, dict[str, Any]]:
    """Parameters that each node takes."""
    found = {}
    for name, node in nodes.items():
        own = [each for each in node.parameters if isinstance(each, dict)]
        files = [Path(each) for each in node.parameters if not isinstance(each, dict)]
        for values in own:
            (folder / name).write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
            files.append(folder / name)
        found[name] = overlay.from_files(files)[name]
    return found


def test_hardware_starts_no_stand_in_and_no_torque_without_activation(
    file: dict[str, Any], tmp_path: Path
) -> None:
    nodes = launched(file, config="geodude natnet_ros2")
    assert set(nodes) == {"torque_controller", "demonstration_recorder", "pancake_tracker"}
    expected = overlay.setup(["geodude", "natnet_ros2"], task="flip")
    assert setup(nodes, tmp_path) == {name: expected[name] for name in nodes}
    assert not setup(nodes, tmp_path)["torque_controller"]["autostart"]
    with pytest.raises(RuntimeError, match="config is empty"):
        launched(file)
    with pytest.raises(RuntimeError, match="no set-up 'geodud'"):
        launched(file, config="geodud")


@pytest.mark.parametrize("task", ["flip", "reach", "ball_in_cup"])
def test_a_simulation_has_the_parameters_of_wam_power(
    task: str, file: dict[str, Any], tmp_path: Path
) -> None:
    nodes = launched(file, simulate="lockstep", task=task, session="s", seed="7")
    expected = overlay.setup(task=task).changed({"wam_sim": {"seed": 7}})
    found = setup(nodes, tmp_path)
    assert ("pancake_tracker" in nodes) == (task != "reach")
    for name in ("torque_controller", "pancake_tracker", "wam_sim"):
        assert found.get(name, expected[name]) == expected[name]
    assert found["learner"]["session"] == str(Path("s").absolute())
    assert found["demonstration_recorder"]["directory"] == str(Path("s").absolute() / "bags")
    given = {name: found["learner"][name] for name in ("task", "seed", "use_sim_time")}
    assert given == {"task": task, "seed": 7, "use_sim_time": True}
    assert found["learner"]["reset_faults"]


def test_each_node_of_a_namespace_has_its_clock_and_its_enclave(file: dict[str, Any]) -> None:
    for name, node in launched(file, simulate="real_time", namespace="/left/").items():
        assert node.namespace == "/left"
        assert node.remappings == [("/clock", "/left/clock")]
        assert node.ros_arguments == ["--enclave", f"/left/{name}"]


def test_the_loss_of_recorder_or_tracker_ends_no_session_and_their_refusal_does(
    file: dict[str, Any],
) -> None:
    nodes = launched(file, simulate="lockstep", session="s")
    restarted = {name for name, node in nodes.items() if node.respawn}
    assert restarted == {"demonstration_recorder", "pancake_tracker"}
    running = SimpleNamespace(is_shutdown=False)
    killed, refused, done = (
        SimpleNamespace(returncode=status, process_name="node") for status in (-9, 2, 0)
    )
    recorder, controller = nodes["demonstration_recorder"], nodes["torque_controller"]
    assert recorder.on_exit(killed, running) is None
    for event, node in ((refused, recorder), (refused, controller), (killed, controller)):
        with pytest.raises(RuntimeError, match=f"node ended with status {event.returncode}"):
            node.on_exit(event, running)
    assert "has ended" in controller.on_exit(done, running).reason
