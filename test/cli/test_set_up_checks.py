# SPDX-License-Identifier: Apache-2.0
"""Mistakes in the file of an arm, each found and named by `doctor` and by `config`."""

from __future__ import annotations

from pathlib import Path

import pytest

from wam_power_ros.cli import commands, doctor_command
from wam_power_ros.cli.launcher import Devices
from wam_power_ros.cli.set_up_checks import mistakes
from wam_power_ros.params import overlay

JOINTS = [f"cobot_joint{number}" for number in range(1, 8)]
# What is planted at the controller, and what is said of it.
OF_CONTROLLER = {
    "a parameter that does not exist": ({"tool_frmae": "pan"}, "tool_frmae"),
    "a joint too few": ({"model_joint_names": JOINTS[:6]}, "one name for"),
    "joints exchanged": ({"joint_names": [JOINTS[1], JOINTS[0], *JOINTS[2:]]}, "base to tip"),
    "a joint of another arm": (
        {"joint_names": JOINTS, "model_joint_names": ["q1", *JOINTS[1:]]},
        "q1",
    ),
    "a tool that is no link": ({"tool_frame": "hand"}, "hand"),
    "a guarded link that is none": ({"guarded_links": ["cobot_link3", "wrist"]}, "wrist"),
    "guarded points of two links for three": ({"guarded_points": [0.0] * 3}, "guarded_points"),
    "a base that is no link": ({"base_frame": "cobot_bas"}, "cobot_bas"),
    "a URDF that is not there": ({"urdf": "urdf/cobot8.urdf"}, "cobot8"),
    "a table above the home": ({"plane": [0.0, 0.0, 1.0, 1.9]}, "plane"),
}
OF_OTHERS = {
    "a home of another arm": ("wam_sim", {"home": [0.0, 0.2, 0.3, 0.0, -0.5, 0.0]}, "7 angles"),
    "a home in degrees": (
        "wam_sim",
        {"home": [0.0, 11.5, 17.2, 0.0, -28.6, 0.0, 0.0]},
        "cobot_joint2 = 11.5",
    ),
    "a goal out of reach": ("wam_sim", {"goal": [1.6, 0.25, 0.6]}, "beyond the reach"),
    "a task that does not exist": ("learner", {"task": "raech"}, "raech"),
}
MISTAKES = OF_OTHERS | {
    name: ("torque_controller", *planted) for name, planted in OF_CONTROLLER.items()
}


def written(folder: Path, node: str, values: dict[str, object]) -> str:
    """Set-up with these parameters of a node."""
    (file := folder / "mine.yaml").write_text(
        f"{node}: {{ros__parameters: {values}}}\n".replace("'", '"')
    )
    return str(file)


@pytest.mark.parametrize("name", MISTAKES)
def test_each_of_fourteen_mistakes_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    node, values, named = MISTAKES[name]
    devices = Devices(["cobot", written(tmp_path, node, values)])
    task = None if node == "learner" else "reach"
    try:
        assert doctor_command.doctor(devices, task) == 1
        text = capsys.readouterr().out
        assert "set-up       NO" in text
    except (ValueError, OSError) as error:
        text = str(error)
    assert named in text
    if task is not None:  # `config` has that of its option
        with pytest.raises((ValueError, OSError), match=named):
            commands.config(devices, task)


def test_no_set_up_of_ours_has_a_mistake() -> None:
    with_a_cup = ["geodude", "libbarrett"]
    every = [*with_a_cup, "cobot", "ur", "franka", "openarm", "gen3", "xarm7"]
    tasks = [("flip", every), ("reach", every), ("ball_in_cup", with_a_cup)]
    for task, arm in [(task, arm) for task, arms in tasks for arm in arms]:
        assert [*mistakes(overlay.setup([arm], task=task))] == [], (arm, task)


@pytest.mark.parametrize(("task", "asked"), [("reach", False), ("flip", True)])
def test_the_frame_of_cameras_is_asked_for_where_the_task_tracks_a_body(
    task: str, asked: bool
) -> None:
    rows = doctor_command.measured(overlay.setup(["openarm"], task=task))
    assert ("frame" in [row.name for row in rows]) is asked


def test_an_arm_that_takes_positions_needs_no_torques_to_be_measured() -> None:
    rows = doctor_command.measured(overlay.setup(["ur", "position"], task="reach"))
    assert [row.name for row in rows] == ["servo"]
