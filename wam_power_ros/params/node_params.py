# SPDX-License-Identifier: Apache-2.0
"""ROS parameters -> one frozen object; values are in YAML only, the defaults of a node in config/.

A node subclasses `Params` with typed fields and no defaults, is constructed with
`automatically_declare_parameters_from_overrides=True`, and reads its parameters once:
`MyParams.from_node(self)`. Every number has a lower and an upper bound; the field's description
gives the reasons. What is `settable` may change later, if the node accepts it (`follow`).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from wam_power_ros import installed
from wam_power_ros.params import overlay, parameter_file
from wam_power_ros.params.resources import share

if TYPE_CHECKING:  # in-process simulations read the same parameters without ROS
    from pydantic_core import ErrorDetails
    from rclpy.node import Node
    from rclpy.parameter import Parameter

P = TypeVar("P", bound="Params")
Names = Annotated[tuple[str, ...], Field(max_length=64, description="at most 64 names")]
Timeout = Annotated[
    float, Field(ge=0.1, le=86_400.0, description="in s: an answer takes 0.1 s; at most a day")
]
AT_START = "read at start: change the YAML and restart the node"
AT_REST = "may be set at rest; the node says what it refuses"
SHOWN_LENGTH_MAX = 80  # characters of a refused value in its message


class Params(BaseModel):
    """Parameters of a node: strictly typed, finite and frozen; lists become tuples.

    A subclass may include settings by inheriting from their class as well; defaults that they have
    there do not count here.
    """

    file: ClassVar[str] = ""  # file in config/ with defaults and comments, named after the node
    constants: ClassVar[set[str]] = set()  # included settings that are no parameters
    settable: ClassVar[set[str]] = set()  # while the node runs

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, str_max_length=10_000
    )

    @classmethod
    def from_node(cls: type[P], node: Node) -> P:
        """Read the parameters of `node` and make them read-only.

        A ValueError names keys that are unknown, missing, of a wrong type or out of range, and a
        file of `--params-file` that is malformed.
        """
        if cls.file:
            cls._complete(node)
        for file in () if cls.file else parameter_file.given(sys.argv):
            parameter_file.read(file)
        given = node.get_parameters_by_prefix("").items()
        values = {k: plain(() if it.value is None else it.value) for k, it in given}
        params = cls.from_values(node.get_name(), values)
        cls._describe(node)
        return params

    @classmethod
    def _complete(cls, node: Node) -> None:
        """Give a node of `overlay.NODES` what its files say, and else its defaults.

        They belong to its kind, whatever its name. A value of the command line stays. Parameters of
        other nodes that reach it by a section of all nodes, or by the command line of both
        stand-ins, are not its own.
        """
        from rclpy.parameter import Parameter

        kind, name, namespace = Path(cls.file).stem, node.get_name(), node.get_namespace()
        files = parameter_file.given(sys.argv)
        setup = overlay.from_files(files, namespace, name, kind)
        passed: dict[str, Any] = {"use_sim_time": False}  # by ROS, from the files
        foreign: set[str] = set()
        if kind in overlay.STAND_INS:
            foreign = {each for other in overlay.STAND_INS for each in setup[other]}
        for file in files:
            sections = parameter_file.of_nodes(file, namespace)
            common = sections.get(parameter_file.ALL_NODES, {})
            foreign |= common.keys()
            passed |= common | sections.get(name, {})
        given = {each: plain(node.get_parameter_or(each).value) for each in setup[kind]}
        words = {k: v for k, v in given.items() if v is not None and v != passed.get(k)}
        setup = overlay.from_files(files, namespace, name, kind, words)
        for each in foreign - setup[kind].keys():
            if node.has_parameter(each) and not parameter_file.of_ros(each):
                node.undeclare_parameter(each)
        for each, value in setup[kind].items():
            if not node.has_parameter(each):
                node.declare_parameter(each, value)
            elif plain(node.get_parameter(each).value) == passed.get(each):
                node.set_parameters([Parameter(each, value=value)])

    @classmethod
    def _describe(cls, node: Node) -> None:
        """Set the description and range of every parameter, and make it read-only."""
        from rcl_interfaces.msg import ParameterDescriptor

        comments = parameter_file.comments(share(f"config/{cls.file}")) if cls.file else {}
        properties = cls.model_json_schema()["properties"]
        for name in cls.model_fields.keys() - cls.constants:
            about = properties[name].get("description")
            sentences = (comments.get(name), about and f"Range: {about}")
            descriptor = ParameterDescriptor(
                type=node.get_parameter(name).type_.value,
                description=". ".join(filter(None, sentences)),
                additional_constraints=AT_REST if name in cls.settable else AT_START,
                read_only=name not in cls.settable,
                **_range(properties[name]),
            )
            node.set_descriptor(name, descriptor)
        clock = ParameterDescriptor(
            type=node.get_parameter("use_sim_time").type_.value,
            description="Lockstep: time comes from /clock, and the watchdogs for states are off",
            read_only=True,
        )
        node.set_descriptor("use_sim_time", clock)

    def follow(self: P, node: Node, accept: Callable[[P], None]) -> None:
        """Let `accept` take the parameters when some are set, or refuse them by a ValueError."""
        from rcl_interfaces.msg import SetParametersResult

        known = self

        def on_set(given: Sequence[Parameter[Any]]) -> SetParametersResult:
            nonlocal known
            own = {it.name: plain(it.value) for it in given if it.name in type(self).settable}
            try:
                values = known.model_dump(exclude=type(self).constants) | own
                accept(changed := self.from_values(node.get_name(), values))
            except ValueError as error:
                return SetParametersResult(successful=False, reason=str(error))
            known = changed
            return SetParametersResult(successful=True)

        node.add_on_set_parameters_callback(on_set)

    @classmethod
    def from_setup(cls: type[P], setup: overlay.Setup) -> P:
        """Read the parameters of the node that `file` is named after from a set-up."""
        node = Path(cls.file).stem
        return cls.from_values(node, setup[node])

    @classmethod
    def from_values(cls: type[P], owner: str, values: Mapping[str, object]) -> P:
        """Check values from YAML for a node; parameters that ROS itself defines are ignored."""
        own = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in values.items()
            if not parameter_file.of_ros(name)
        }
        return cls._checked(owner, own)

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
        if error["type"] == "extra_forbidden":
            return f"{key} is no parameter{installed.did_you_mean(key, [*cls.model_fields])}"
        shown = repr(error["input"])
        shown = shown if len(shown) <= SHOWN_LENGTH_MAX else f"{shown[:SHOWN_LENGTH_MAX]}..."
        field = cls.model_fields.get(str(error["loc"][0]))
        reason = f" ({field.description})" if field is not None and field.description else ""
        return f"{key} = {shown}: {rule}{reason}"


def plain(value: object) -> object:
    """A list for any sequence but text, to compare values of ROS and of YAML."""
    return value if value is None or isinstance(value, (str, int, float)) else list(value)


def _range(schema: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Range of a number, as a field of a descriptor; empty for other values."""
    from rcl_interfaces.msg import FloatingPointRange, IntegerRange

    low = schema.get("minimum", schema.get("exclusiveMinimum"))
    high = schema.get("maximum", schema.get("exclusiveMaximum"))
    if low is None or high is None:
        return {}
    if schema["type"] == "integer":
        return {"integer_range": [IntegerRange(from_value=int(low), to_value=int(high))]}
    limits = FloatingPointRange(from_value=float(low), to_value=float(high))
    return {"floating_point_range": [limits]}
