# SPDX-License-Identifier: Apache-2.0
"""ROS parameters -> one frozen object; values live in YAML only, so a missing key stops the node.

A node subclasses `Params` with typed fields and no defaults, is constructed with
`automatically_declare_parameters_from_overrides=True`, and reads once: `MyParams.of(self)`. Every
number has a lower and an upper bound; the field's description says what they come from.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from wam_power_ros.params import parameter_file

if TYPE_CHECKING:  # the same parameters are read without ROS by what runs in one process
    from pydantic_core import ErrorDetails
    from rcl_interfaces.msg import SetParametersResult
    from rclpy.node import Node
    from rclpy.parameter import Parameter

P = TypeVar("P", bound="Params")
Names = Annotated[tuple[str, ...], Field(max_length=64, description="a list of names, for people")]
SHOWN_MAX = 80  # characters of a refused value in its message
OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


class Params(BaseModel):
    """Parameters of a node: strictly typed, finite, frozen; lists come as tuples."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, str_max_length=10_000
    )

    @classmethod
    def of(cls: type[P], node: Node) -> P:
        """Read the parameters of `node`, which refuses later changes to them.

        Raises:
            ValueError: When keys are missing, unknown, of a wrong type or out of range; names them.
                When a file of `--params-file` is malformed: ROS itself lets a key be there twice.
        """
        for file in parameter_file.given(sys.argv):
            parameter_file.read(file)
        given = node.get_parameters_by_prefix("").items()
        values = {
            name: parameter.value
            if isinstance(parameter.value, (bool, int, float, str))
            else tuple(parameter.value or ())
            for name, parameter in given
            if not name.startswith(OF_ROS)
        }
        params = cls._checked(node.get_name(), values)
        node.add_on_set_parameters_callback(_refuse)
        return params

    @classmethod
    def of_file(cls: type[P], path: Path, node: str, *over: Path) -> P:
        """Read the parameters of a node from YAML files, as the node would.

        Args:
            path: File of the node.
            node: Name of the node.
            over: Files that override it, later ones first; one may have nothing for this node.

        Raises:
            ValueError: As for `of`, and when the node's own file has nothing for it.
        """
        values: dict[str, object] = {}
        for file in (path, *over):
            nodes = parameter_file.read(file)
            if file != path and node not in nodes:
                continue
            if node not in nodes:
                raise ValueError(f"{file} has no parameters for {node}")
            values |= {
                name: tuple(value) if isinstance(value, list) else value
                for name, value in nodes[node].items()
                if not name.startswith(OF_ROS)
            }
        return cls._checked(f"{node} in {path}", values)

    @classmethod
    def of_values(cls: type[P], whose: str, values: Mapping[str, object]) -> P:
        """Check values read from YAML, for a node called `whose`; those of ROS itself are ignored.

        Raises:
            ValueError: As for `of`.
        """
        own = {name: value for name, value in values.items() if not name.startswith(OF_ROS)}
        lists = {name: tuple(value) for name, value in own.items() if isinstance(value, list)}
        return cls._checked(whose, own | lists)

    @classmethod
    def _checked(cls: type[P], whose: str, values: Mapping[str, object]) -> P:
        try:
            return cls(**values)
        except ValidationError as error:
            faults = "; ".join(cls._fault(fault) for fault in error.errors())
            raise ValueError(f"parameters of {whose} refused: {faults}") from None

    @classmethod
    def _fault(cls, fault: ErrorDetails) -> str:
        """Key, value and rule that it breaks, in one line."""
        key = ".".join(map(str, fault["loc"])) or "all"
        if fault["type"] == "missing":
            return f"{key} is missing"
        rule = fault["msg"].removeprefix("Value error, ")
        if key == "all":
            return rule
        shown = repr(fault["input"])
        shown = shown if len(shown) <= SHOWN_MAX else f"{shown[:SHOWN_MAX]}..."
        field = cls.model_fields.get(str(fault["loc"][0]))
        reason = f" ({field.description})" if field is not None and field.description else ""
        return f"{key} = {shown}: {rule}{reason}"


def _refuse(parameters: list[Parameter]) -> SetParametersResult:
    from rcl_interfaces.msg import SetParametersResult

    fixed = [parameter.name for parameter in parameters if not parameter.name.startswith(OF_ROS)]
    reason = f"{fixed} are read at start: change the YAML and start the node again"
    return SetParametersResult(successful=not fixed, reason=reason if fixed else "")
