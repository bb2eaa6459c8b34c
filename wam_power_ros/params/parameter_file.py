# SPDX-License-Identifier: Apache-2.0
"""YAML files of ROS parameters, read as ROS reads them, and refused where ROS would guess.

Numbers are decimal: `1:30` is text, not 90, and `010` is text, not 8. A key that is given twice is
refused with both lines, where ROS would silently use the last one.
"""

from __future__ import annotations

import itertools
import re
import reprlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml

from wam_power_ros import plain_yaml

_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")  # prefixes
ALL_NODES = "**"  # name, without namespace, of the section of all nodes: `/**`
_TAG = "tag:yaml.org,2002:"
_INT = re.compile(r"[-+]?(0|[1-9][0-9]*)$")
_COMMENTED = re.compile(r"^    (\w+):[^#\n]*((?:#.*)?(?:\n     +#.*)*)", re.MULTILINE)
_FLOAT = re.compile(
    r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?$|[-+]?[0-9]+[eE][-+]?[0-9]+$"
)


class Loader(plain_yaml.Loader):
    """Loads plain data: decimal numbers, unique keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Refuse a key that is given twice."""
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                line = key.start_mark.line + 1
                if key.value in lines:
                    first = lines[key.value]
                    text = f"{key.value} is given twice, in line {first} and in line {line}"
                    raise yaml.YAMLError(text)
                lines[key.value] = line
        return dict(super().construct_mapping(node, deep))


class PlainLoader(Loader):
    """Loads what ROS itself can read: every list of one kind."""

    def construct_sequence(self, node: yaml.SequenceNode, deep: bool = False) -> list[Any]:
        """Refuse a list of several kinds or none, as ROS does without naming file or parameter."""
        if not node.value:
            line = node.start_mark.line + 1
            raise yaml.YAMLError(f'line {line}: ROS has no empty lists; write [""] for no names')
        if len({item.tag for item in node.value}) > 1:
            shown = ", ".join(str(getattr(item, "value", "...")) for item in node.value)
            raise yaml.YAMLError(
                f"line {node.start_mark.line + 1}: [{reprlib.repr(shown)[1:-1]}] must be of one "
                "kind: write 2.0, not 2, in a list of decimal numbers"
            )
        return list(super().construct_sequence(node, deep))


Loader.yaml_implicit_resolvers = {
    first: [pair for pair in pairs if pair[0] in (_TAG + "bool", _TAG + "null")]
    for first, pairs in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
# launch_ros writes a list of `parameters=[{...}]` so, and ROS reads it as a list.
Loader.add_constructor(
    _TAG + "python/tuple", lambda loader, node: list(loader.construct_sequence(node, deep=True))
)
Loader.add_implicit_resolver(_TAG + "int", _INT, list("-+0123456789"))
Loader.add_implicit_resolver(_TAG + "float", _FLOAT, list("-+.0123456789"))


def read(file: Path, loader: type = Loader) -> dict[str, dict[str, Any]]:
    """Read the parameters by node from one file; names of nodes include their namespace.

    A file that ROS itself is to read needs the loader `PlainLoader`. A ValueError names the file
    that cannot be read and, for a duplicate key, both lines.
    """
    nodes = plain_yaml.read(file, loader)
    try:
        return dict(_sections(nodes or {}))
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None


def _sections(nodes: object, parent: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Nodes and their parameters; a namespace may be a separate level."""
    for name, section in _mapping(nodes, parent or "the file").items():
        path = f"{parent}/{str(name).lstrip('/')}" if parent else str(name)
        if "ros__parameters" in _mapping(section, path):
            yield path, _mapping(section["ros__parameters"], f"ros__parameters of {path}")
        elif not section or not all(isinstance(child, dict) for child in section.values()):
            raise ValueError(f"{path} has no ros__parameters")
        else:
            yield from _sections(section, path)


def _mapping(value: object, where: str) -> dict[Any, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{where} is {reprlib.repr(value)}; allowed are names with values")
    return value


def of_nodes(file: Path, namespace: str = "") -> dict[str, dict[str, Any]]:
    """Read the parameters by name of the node, without its namespace; ALL_NODES for all.

    With a namespace, such as `/left` or `/`, those of its nodes alone. A ValueError as for `read`,
    or if the file has a node in two namespaces and none is given.
    """
    found: dict[str, dict[str, Any]] = {}
    for path, values in read(file).items():
        above, _, name = path.rpartition("/")
        anywhere = above == "/**" or path in ("/**", "**")
        if namespace and not anywhere and f"/{above.strip('/')}" != namespace:
            continue
        if name in found and not namespace:
            raise ValueError(f"{file} has parameters for {name} twice; use one file for each")
        found[name] = {**found.get(name, {}), **values}
    return found


def comments(file: Path) -> dict[str, str]:
    """Comments by parameter in a file of config/: beside the value, and in the lines below it."""
    commented = _COMMENTED.findall(file.read_text(encoding="utf-8"))
    lines = {name: [line.strip("# ") for line in text.splitlines()] for name, text in commented}
    return {name: " ".join(texts).strip() for name, texts in lines.items() if any(texts)}


def given(arguments: Sequence[str]) -> list[Path]:
    """Files of the options `--params-file` among the arguments of a process."""
    pairs = itertools.pairwise(arguments)
    return [Path(value) for option, value in pairs if option == "--params-file"]


def of_ros(name: object) -> bool:
    """Whether ROS itself defines a parameter."""
    return str(name).startswith(_OF_ROS)
