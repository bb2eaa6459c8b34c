# SPDX-License-Identifier: Apache-2.0
"""A set-up that `wam-power config` accepts is accepted by every node, read by ROS itself."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
import yaml
from all_params import READS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rclpy.node import Node

from wam_power_ros.cli import main
from wam_power_ros.params import overlay, parameter_file
from wam_power_ros.ros.domain import private_domain

USUAL = overlay.setup(simulated=True)
Accepts = Callable[[dict[str, dict[str, object]]], str]
WHOLE = {
    "torque_controller": {"workspace_max": [1.5, 1.5, 2], "elbow_speed_max": 1},
    "pancake_tracker": {"world_to_base": [0.5, 0, 0, 0, 0, 0, 1], "rate": 120},
}


@pytest.fixture(scope="module")
def context() -> Iterator[rclpy.Context]:
    context = rclpy.Context()
    with private_domain() as domain:
        rclpy.init(context=context, domain_id=domain)
        yield context
        rclpy.shutdown(context=context)


@pytest.fixture
def accepted(tmp_path: Path) -> Accepts:
    """Function that returns what `config` prints for a set-up; empty if it refuses it."""

    def config(values: dict[str, dict[str, object]]) -> str:
        file = tmp_path / "lab.yaml"
        text = {node: {"ros__parameters": given} for node, given in values.items()}
        file.write_text(yaml.safe_dump(text, allow_unicode=True))
        printed, refused = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(refused):
            status = main.main(["config", "--config", str(file), "--simulate"])
        assert status in (0, 2), refused.getvalue()
        assert bool(printed.getvalue()) == (status == 0)
        return printed.getvalue()

    return config


def read_by_ros(context: rclpy.Context, file: Path) -> None:
    """Let ROS read the parameters of every node with others than usual, and check them as it does.

    The usual ones are read wherever a node is started.
    """
    given = parameter_file.of_nodes(file)
    for name, params in READS.items():
        if given[name] == USUAL[name]:
            continue
        node: Node = rclpy.create_node(
            name,
            context=context,
            cli_args=["--ros-args", "--params-file", str(file)],
            start_parameter_services=False,
            enable_rosout=False,
            automatically_declare_parameters_from_overrides=True,
        )
        try:
            params.of(node)
        finally:
            node.destroy_node()


def test_whole_numbers_and_empty_lists_are_written_as_ros_has_them(
    accepted: Accepts, context: rclpy.Context, tmp_path: Path
) -> None:
    text = accepted(WHOLE | {"wam_sim": {"listeners": []}})
    assert '"listeners": [""]' in text
    assert '"workspace_max": [1.5, 1.5, 2.0]' in text and '"elbow_speed_max": 1.0' in text
    assert text.count('"world_to_base": [0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]') == 2
    file = tmp_path / "parameters.yaml"
    file.write_text(text)
    read_by_ros(context, file)


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


NUMBERS = st.one_of(
    st.integers(-3, 3),
    st.floats(-3.0, 3.0, width=32),
    st.sampled_from([0, 1, 2**31, 2**63, 1e-9, 5e17, 1e300]),
)
TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), max_size=5)
OWN = overlay.setup()
CHOICES = [(node, name) for node in overlay.NODES for name in OWN[node] if name != "use_sim_time"]


def like(value: object) -> st.SearchStrategy[object]:
    """Values of the kind of a parameter, most of them near what is accepted."""
    if isinstance(value, list):
        item = like(value[0]) if value else TEXTS
        changed = st.lists(item, min_size=len(value), max_size=len(value))
        return st.one_of(changed, st.lists(item, max_size=2))
    if isinstance(value, bool):
        return st.booleans()
    return TEXTS if isinstance(value, str) else NUMBERS


@settings(
    max_examples=8, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_what_config_accepts_the_nodes_accept(
    data: st.DataObject, accepted: Accepts, context: rclpy.Context, tmp_path: Path
) -> None:
    node, name = data.draw(st.sampled_from(CHOICES))
    value = data.draw(like(OWN[node][name]))
    if text := accepted({node: {name: value}}):
        file = tmp_path / "parameters.yaml"
        file.write_text(text)
        read_by_ros(context, file)
