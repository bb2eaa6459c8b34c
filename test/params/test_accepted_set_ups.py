# SPDX-License-Identifier: Apache-2.0
"""A set-up that `wam-power config` accepts is accepted by every node, read by ROS itself."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import rclpy
import yaml
from all_params import READS

from wam_power_ros.cli import main

WHOLE = {
    "torque_controller": {"workspace_max": [1.5, 1.5, 2], "guarded_speed_max": 1},
    "pancake_tracker": {"world_to_base": [0.5, 0, 0, 0, 0, 0, 1], "rate": 120},
    "wam_sim": {"listeners": []},
}


def test_whole_numbers_and_empty_lists_are_written_as_ros_has_them(
    domain_id: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text(yaml.safe_dump({node: {"ros__parameters": of} for node, of in WHOLE.items()}))
    assert main.main(["config", "--config", str(file), "--simulate"]) == 0
    text = capsys.readouterr().out
    assert '"listeners": [""]' in text
    assert '"workspace_max": [1.5, 1.5, 2.0]' in text and '"guarded_speed_max": 1.0' in text
    assert text.count('"world_to_base": [0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]') == 2
    file.write_text(text)
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain_id)
    for name in {*WHOLE, "optitrack_sim"}:
        node = rclpy.create_node(
            name,
            context=context,
            cli_args=["--ros-args", "--params-file", str(file)],
            automatically_declare_parameters_from_overrides=True,
        )
        READS[name].from_node(node)
        node.destroy_node()
    rclpy.shutdown(context=context)


@pytest.mark.parametrize(
    ("node", "values", "says"),
    [
        ("pancake_tracker", {"markers_topic": "cloud", "pose_topic": "pose"}, "set either"),
        ("torque_controller", {"workspace_min": [1, 1, 1], "workspace_max": [0, 0, 0]}, "worksp"),
        ("torque_controller", {"workspace_min": []}, "one like"),
        ("learner", {"seed": 2**63}, "seed"),
        ("optitrack_sim", {"together": 0}, "together"),
    ],
)
def test_what_a_node_would_refuse_config_refuses(
    node: str, values: dict[str, object], says: str, refusal: Callable[..., str], tmp_path: Path
) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text(yaml.safe_dump({node: {"ros__parameters": values}}))
    assert says in refusal("config", "--config", str(file), "--simulate")
