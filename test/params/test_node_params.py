# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: complete, known, in range, and fixed once read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import pytest
import rclpy
from conftest import ROOT
from pydantic import Field
from rclpy.node import Node
from rclpy.parameter import Parameter

from hardware_sim.settings import ArmSimParams, OptitrackSimParams
from wam_power_ros.nodes.demonstration_recorder import DemonstrationRecorderParams
from wam_power_ros.nodes.learner import LearnerParams
from wam_power_ros.params.body_tracker_params import BodyTrackerParams
from wam_power_ros.params.node_params import Params
from wam_power_ros.params.parameter_file import of_nodes
from wam_power_ros.params.torque_controller_params import TorqueControllerParams


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
    oven = Oven.of(node_with(**GOOD))
    assert oven == Oven(**(GOOD | {"limits": (1.0, 2.0), "shelves": ("a", "b")}))
    with pytest.raises(ValueError, match="frozen"):
        oven.rings = 5


@pytest.mark.parametrize("missing", ["name", "limits"])
def test_a_missing_key_is_named(node_with: Callable[..., Node], missing: str) -> None:
    with pytest.raises(ValueError, match=f"oven.*{missing}"):
        Oven.of(node_with(**{name: value for name, value in GOOD.items() if name != missing}))


def test_unknown_keys_and_bad_values_are_named_at_once(node_with: Callable[..., Node]) -> None:
    wrong = {"unheard_of": 1, "rings": 2.5, "heat": float("nan"), "name": 7, "limits": ["a"]}
    with pytest.raises(ValueError, match="parameters of oven refused") as refused:
        Oven.of(node_with(**(GOOD | wrong)))
    assert [name for name in wrong if name not in str(refused.value)] == []
    assert "\n" not in str(refused.value)


@pytest.mark.requirement("S-18")
def test_a_parameter_that_was_read_cannot_be_changed(node_with: Callable[..., Node]) -> None:
    node = node_with(**GOOD)
    Oven.of(node)
    (result,) = node.set_parameters([Parameter("heat", value=10.0)])
    assert not result.successful
    assert "heat" in result.reason
    assert node.get_parameter("heat").value == GOOD["heat"]
    (result,) = node.set_parameters([Parameter("use_sim_time", value=True)])
    assert not result.successful  # the watchdogs depend on it
    assert not node.get_parameter("use_sim_time").value


PARAMS = (
    TorqueControllerParams,
    ArmSimParams,
    OptitrackSimParams,
    LearnerParams,
    BodyTrackerParams,
    DemonstrationRecorderParams,
)


@pytest.mark.parametrize("params", PARAMS)
def test_a_yaml_holds_exactly_what_its_node_reads(params: type[Params]) -> None:
    file = ROOT / "config" / params.file
    values = of_nodes(file)[file.stem]
    assert set(values) == params.model_fields.keys() - params.constants
    params.of_values(file.stem, values)


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
    assert list(unbounded(params)) == []
    assert params.model_config["str_max_length"]


def test_settings_that_a_node_includes_are_parameters_without_default_or_constants() -> None:
    values = of_nodes(ROOT / "config/wam_sim.yaml")["wam_sim"]
    less = {name: value for name, value in values.items() if name not in ("friction", "home")}
    with pytest.raises(ValueError, match="friction is missing; home is missing"):
        ArmSimParams.of_values("wam_sim", less)
    with pytest.raises(ValueError, match="body_mass is no parameter"):
        ArmSimParams.of_values("wam_sim", values | {"body_mass": 0.9})


def test_a_parameter_without_a_bound_is_detected() -> None:
    assert list(unbounded(Oven)) == [
        "rings: no upper bound",
        "heat: no upper bound",
        "limits: any number of items",
        "limits[]: no lower bound",
        "limits[]: no upper bound",
        "shelves: any number of items",
    ]


def test_a_refusal_names_key_value_rule_and_reason(node_with: Callable[..., Node]) -> None:
    class Grill(Oven):
        heat: float = Field(ge=50.0, le=300.0, description="in C: the thermostat's range")

    with pytest.raises(ValueError, match=r"heat = 301\.0: .*300 .*the thermostat's range"):
        Grill.of(node_with(**(GOOD | {"heat": 301.0})))
    with pytest.raises(ValueError, match=r"heat = '1:30': .* valid number"):
        Grill.of(node_with(**(GOOD | {"heat": "1:30"})))


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
        Oven.of(node_with(**GOOD))
