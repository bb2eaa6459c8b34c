# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: complete, known, in range, and fixed once read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import pytest
import rclpy
from all_params import READS
from conftest import ROOT
from pydantic import Field
from rclpy.node import Node
from rclpy.parameter import Parameter

from hardware_sim.settings import ArmSimParams
from wam_power_ros.nodes.learner import LearnerParams
from wam_power_ros.params.node_params import Params
from wam_power_ros.params.parameter_file import comments, of_nodes


class Oven(Params):
    """An example of a node's parameters."""

    name: str
    rings: Annotated[int, Field(ge=1)]
    heat: Annotated[float, Field(gt=0.0)]
    limits: tuple[float, ...]
    shelves: tuple[str, ...]


GOOD = {"name": "aga", "rings": 4, "heat": 200.0, "limits": [1.0, 2.0], "shelves": ["a", "b"]}


@pytest.fixture
def node_with(domain_id: int) -> Iterator[Callable[..., Node]]:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain_id)

    def make(**values: object) -> Node:
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        return rclpy.create_node(
            "oven",
            context=context,
            parameter_overrides=overrides,
            automatically_declare_parameters_from_overrides=True,
        )

    yield make
    rclpy.shutdown(context=context)


def test_parameters_come_as_one_frozen_object(node_with: Callable[..., Node]) -> None:
    oven = Oven.from_node(node_with(**GOOD))
    assert oven == Oven(**(GOOD | {"limits": (1.0, 2.0), "shelves": ("a", "b")}))
    with pytest.raises(ValueError, match="frozen"):
        oven.rings = 5


@pytest.mark.parametrize(
    ("name", "value"),
    [("unheard_of", 1), ("rings", 2.5), ("heat", float("nan")), ("name", 7), ("limits", ["a"])],
)
def test_an_unknown_key_or_a_bad_value_is_named(
    node_with: Callable[..., Node], name: str, value: object
) -> None:
    with pytest.raises(ValueError, match=name):
        Oven.from_node(node_with(**(GOOD | {name: value})))


def test_a_mistyped_parameter_is_answered_with_the_one_that_is_meant(
    node_with: Callable[..., Node],
) -> None:
    with pytest.raises(ValueError, match="heatt is no parameter; did you mean 'heat'"):
        Oven.from_node(node_with(**GOOD, heatt=1.0))


@pytest.mark.requirement("S-18")
def test_a_parameter_that_was_read_cannot_be_changed(node_with: Callable[..., Node]) -> None:
    node = node_with(**GOOD)
    Oven.from_node(node)
    (result,) = node.set_parameters([Parameter("heat", value=10.0)])
    assert not result.successful
    assert "heat" in result.reason
    assert node.get_parameter("heat").value == GOOD["heat"]
    (result,) = node.set_parameters([Parameter("use_sim_time", value=True)])
    assert not result.successful  # the watchdogs depend on it
    assert not node.get_parameter("use_sim_time").value


def test_every_parameter_describes_itself_its_range_and_that_it_is_read_at_start(
    node_with: Callable[..., Node],
) -> None:
    values = of_nodes(ROOT / "config/learner.yaml")["learner"]
    node = node_with(**values)
    LearnerParams.from_node(node)
    described = {name: node.describe_parameter(name) for name in LearnerParams.model_fields}
    assert all(each.read_only and each.description for each in described.values())
    (limits,) = described["trials"].integer_range
    assert (limits.from_value, limits.to_value) == (0, 100_000)
    (limits,) = described["patience"].floating_point_range
    assert (limits.from_value, limits.to_value) == (0.1, 86_400.0)
    assert not described["task"].integer_range


NAMES = "torque_controller wam_sim optitrack_sim learner pancake_tracker demonstration_recorder"
PARAMS = [READS[name] for name in NAMES.split()]


@pytest.mark.parametrize("params", PARAMS)
def test_a_yaml_holds_exactly_what_its_node_reads(params: type[Params]) -> None:
    values = of_nodes(ROOT / "config" / params.file)[Path(params.file).stem]
    assert set(values) == params.model_fields.keys() - params.constants
    lists = {name: tuple(value) for name, value in values.items() if isinstance(value, list)}
    params(**(values | lists))
    described = comments(ROOT / "config" / params.file)
    undescribed = {name for name, each in params.model_fields.items() if not each.description}
    assert undescribed - set(described) - params.constants == set()


def unbounded(params: type[Params]) -> Iterator[str]:
    """Parameters without a lower or an upper bound, of their numbers or of their length."""

    def missing(name: str, schema: dict) -> Iterator[str]:
        kind = schema.get("type")
        if kind in ("integer", "number"):
            if not schema.keys() & {"minimum", "exclusiveMinimum"}:
                yield f"{name}: no lower bound"
            if not schema.keys() & {"maximum", "exclusiveMaximum"}:
                yield f"{name}: no upper bound"
        elif kind == "array":
            if "maxItems" not in schema:
                yield f"{name}: any number of items"
            for item in (*schema.get("prefixItems", ()), schema.get("items") or {}):
                yield from missing(f"{name}[]", item)

    for name, schema in params.model_json_schema()["properties"].items():
        yield from missing(name, schema)


@pytest.mark.requirement("S-18")
@pytest.mark.parametrize("params", PARAMS)
def test_every_number_among_the_parameters_has_a_lower_and_an_upper_bound(
    params: type[Params],
) -> None:
    assert len([*unbounded(Oven)]) == 6  # of rings, heat, limits and shelves
    assert list(unbounded(params)) == []
    assert params.model_config["str_max_length"]


def test_settings_that_a_node_includes_are_parameters_without_default_or_constants() -> None:
    values = of_nodes(ROOT / "config/wam_sim.yaml")["wam_sim"]
    less = {name: value for name, value in values.items() if name not in ("friction", "home")}
    with pytest.raises(ValueError, match="friction is missing; home is missing"):
        ArmSimParams.from_values("wam_sim", less)
    with pytest.raises(ValueError, match="body_mass is no parameter"):
        ArmSimParams.from_values("wam_sim", values | {"body_mass": 0.9})


@pytest.mark.requirement("S-18")
def test_a_key_twice_in_the_parameter_file_of_a_process_stops_its_node(
    node_with: Callable[..., Node], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "oven.yaml"
    file.write_text("oven:\n  ros__parameters:\n    heat: 1.0\n    rings: 2\n    heat: 200.0\n")
    monkeypatch.setattr("sys.argv", ["oven", "--ros-args", "--params-file", str(file)])
    with pytest.raises(
        ValueError, match=r"oven\.yaml.*: heat is given twice, in line 3 and in line 5"
    ):
        Oven.from_node(node_with(**GOOD))
