# SPDX-License-Identifier: Apache-2.0
"""ROS parameters -> one frozen object; values are in YAML only, so a missing key stops the node.

A node subclasses `Params` with typed fields and no defaults, is constructed with
`automatically_declare_parameters_from_overrides=True`, and reads its parameters once:
`MyParams.of(self)`. Every number has a lower and an upper bound; the field's description gives the
reasons.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from wam_power_ros.params import overlay, parameter_file
from wam_power_ros.params.resources import share

if TYPE_CHECKING:  # in-process simulations read the same parameters without ROS
    from pydantic_core import ErrorDetails
    from rclpy.node import Node

P = TypeVar("P", bound="Params")
Names = Annotated[tuple[str, ...], Field(max_length=64, description="at most 64 names")]
Timeout = Annotated[
    float, Field(ge=0.1, le=86_400.0, description="in s: an answer takes 0.1 s; at most a day")
]
SHOWN_LENGTH_MAX = 80  # characters of a refused value in its message


class Params(BaseModel):
    """Parameters of a node: strictly typed, finite and frozen; lists become tuples.

    A subclass may include settings by inheriting from their class as well; defaults that they have
    there do not count here.
    """

    file: ClassVar[str] = ""  # file in config/ whose comments describe the parameters
    constants: ClassVar[set[str]] = set()  # included settings that are no parameters

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, str_max_length=10_000
    )

    @classmethod
    def of(cls: type[P], node: Node) -> P:
        """Read the parameters of `node` and make them read-only.

        Raises:
            ValueError: Keys are missing, unknown, of a wrong type or out of range; the message
                names them. Or a file of `--params-file` is malformed: ROS itself accepts a key
                that is given twice.
        """
        for file in parameter_file.given(sys.argv):
            parameter_file.read(file)
        cls._adopt(node)
        given = node.get_parameters_by_prefix("").items()
        values = {
            name: parameter.value
            if isinstance(parameter.value, (bool, int, float, str))
            else tuple(parameter.value or ())
            for name, parameter in given
            if not name.startswith(parameter_file.ROS_PARAMETERS)
        }
        params = cls._checked(node.get_name(), values)
        cls._describe(node)
        return params

    @classmethod
    def _adopt(cls, node: Node) -> None:
        """Set what the plain parameter files of the process say in sections of other nodes.

        A value of the command line stays.
        """
        from rclpy.parameter import Parameter

        if node.get_name() not in overlay.NODES:
            return
        files = parameter_file.given(sys.argv)
        for name, (plain, value) in overlay.adopted(
            node.get_name(), files, node.get_namespace()
        ).items():
            if not node.has_parameter(name):
                node.declare_parameter(name, value)
            elif _plain(node.get_parameter(name).value) == _plain(plain):
                node.set_parameters([Parameter(name, value=value)])

    @classmethod
    def _describe(cls, node: Node) -> None:
        """Set the description and range of every parameter, and make it read-only."""
        from rcl_interfaces.msg import ParameterDescriptor

        comments = parameter_file.comments(share(f"config/{cls.file}")) if cls.file else {}
        for name in cls.model_fields.keys() - cls.constants:
            field = cls.model_fields[name]
            sentences = (comments.get(name), field.description and f"Range: {field.description}")
            given = node.get_parameter(name)
            descriptor = ParameterDescriptor(
                type=given.type_.value,
                description=". ".join(filter(None, sentences)),
                additional_constraints="read at start: change the YAML and restart the node",
                read_only=True,
                **_range(field.metadata, given.value),
            )
            node.set_descriptor(name, descriptor)
        clock = ParameterDescriptor(
            type=node.get_parameter("use_sim_time").type_.value,
            description="Lockstep: time comes from /clock, and the watchdogs for states are off",
            read_only=True,
        )
        node.set_descriptor("use_sim_time", clock)

    @classmethod
    def of_file(cls: type[P], path: Path, node: str, *over: Path) -> P:
        """Read the parameters of a node from YAML files, as the node would.

        Args:
            path: File of the node.
            node: Name of the node.
            over: Files that override it, in order: the last one wins; a file may have no parameters
                for this node.

        Raises:
            ValueError: As for `of`, or the node's own file has no parameters for it.
        """
        values: dict[str, object] = {}
        for file in (path, *over):
            nodes = parameter_file.of_nodes(file)
            if file == path and node not in nodes:
                raise ValueError(f"{file} has no parameters for {node}")
            values |= nodes.get(node, {})
        return cls.of_values(f"{node} in {path}", values)

    @classmethod
    def of_setup(cls: type[P], setup: overlay.Setup) -> P:
        """Read the parameters of the node that `file` is named after from a set-up.

        Raises:
            ValueError: As for `of`.
        """
        node = Path(cls.file).stem
        return cls.of_values(node, setup[node])

    @classmethod
    def of_values(cls: type[P], owner: str, values: Mapping[str, object]) -> P:
        """Check values read from YAML for a node; parameters that ROS itself defines are ignored.

        Args:
            owner: Name of the node, for messages.
            values: Values by name of the parameter.

        Raises:
            ValueError: As for `of`.
        """
        own = {
            name: value
            for name, value in values.items()
            if not name.startswith(parameter_file.ROS_PARAMETERS)
        }
        lists = {name: tuple(value) for name, value in own.items() if isinstance(value, list)}
        return cls._checked(owner, own | lists)

    @classmethod
    def _checked(cls: type[P], owner: str, values: Mapping[str, object]) -> P:
        names = cls.model_fields.keys() - cls.constants
        wrong = [f"{name} is missing" for name in sorted(names - values.keys())]
        wrong += [f"{name} is no parameter" for name in sorted(cls.constants & values.keys())]
        try:
            params = cls(**values)
        except ValidationError as error:
            missing = {("missing", (name,)) for name in names}  # named already
            found = [each for each in error.errors() if (each["type"], each["loc"]) not in missing]
            wrong += map(cls._message, found)
        else:
            if not wrong:
                return params
        raise ValueError(f"parameters of {owner} refused: {'; '.join(wrong)}")

    @classmethod
    def _message(cls, error: ErrorDetails) -> str:
        """Key, value and violated rule, in one line."""
        key = ".".join(map(str, error["loc"]))
        if error["type"] == "missing":
            return f"{key} is missing"
        rule = error["msg"].removeprefix("Value error, ")
        if not key:
            return rule
        shown = repr(error["input"])
        shown = shown if len(shown) <= SHOWN_LENGTH_MAX else f"{shown[:SHOWN_LENGTH_MAX]}..."
        field = cls.model_fields.get(str(error["loc"][0]))
        reason = f" ({field.description})" if field is not None and field.description else ""
        return f"{key} = {shown}: {rule}{reason}"


def _plain(value: object) -> object:
    """A list for any sequence but text, to compare values of ROS and of YAML."""
    return value if value is None or isinstance(value, (str, int, float)) else list(value)


def _range(rules: Sequence[object], value: object) -> dict[str, list[Any]]:
    """Range of a number from its rules, as a field of a descriptor; empty for other values."""
    from rcl_interfaces.msg import FloatingPointRange, IntegerRange

    bounds = {
        name: bound
        for rule in rules
        for name in ("gt", "ge", "lt", "le")
        if (bound := getattr(rule, name, None)) is not None
    }
    low, high = bounds.get("gt", bounds.get("ge")), bounds.get("lt", bounds.get("le"))
    if low is None or high is None or type(value) not in (int, float):
        return {}
    if type(value) is int:
        return {"integer_range": [IntegerRange(from_value=int(low), to_value=int(high))]}
    limits = FloatingPointRange(from_value=float(low), to_value=float(high))
    return {"floating_point_range": [limits]}
