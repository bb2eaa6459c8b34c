# SPDX-License-Identifier: Apache-2.0
"""Plain data from YAML files; large, deep or circular YAML and extreme numbers are refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import yaml

from wam_power_ros import durable_files

SIZE_MAX = 1_000_000  # largest file [byte]
DEPTH_MAX = 20  # largest number of nested levels
INTEGER_MAX = 2**128  # as in `plain_json`; a larger whole number may have no value as a float


class Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Builds plain data, runs nothing."""


def _number(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> Any:  # noqa: ANN401 - int or float
    """A number; infinity, which is refused by name, for one that Python cannot convert."""
    try:
        return yaml.SafeLoader.yaml_constructors[node.tag](loader, node)
    except (ValueError, OverflowError):
        return math.inf


for _kind in ("int", "float"):
    Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _number)


def read(file: Path, loader: type = Loader) -> object:
    """Return the plain data in a YAML file, as `loader` builds it.

    Raises:
        ValueError: As for `parse`, or it is not a regular file or too large.
    """
    return parse(durable_files.read(file, SIZE_MAX), str(file), loader)


def parse(text: bytes, where: str, loader: type = Loader) -> object:
    """Return the plain data in YAML text; `where` names its origin in messages.

    Raises:
        ValueError: It is nested too deeply, has a reference or a number that is not finite or has
            more than 128 bits, or is not YAML that `loader` accepts.
    """
    depth = 0
    try:
        decoded = text.decode()
        for event in yaml.parse(decoded, Loader=loader):
            if isinstance(event, yaml.AliasEvent):
                line = event.start_mark.line + 1
                raise yaml.YAMLError(f"line {line}: references (*name) are refused")
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEPTH_MAX:
                raise yaml.YAMLError(f"it is nested deeper than {DEPTH_MAX} levels")
        data = yaml.load(decoded, Loader=loader)
    except (yaml.YAMLError, ValueError) as error:  # of no UTF-8, or of a date such as 2026-99-99
        raise ValueError(f"{where} is not plain YAML: {' '.join(str(error).split())}") from None
    _check_numbers(data, where)
    return data


def _check_numbers(data: object, name: str) -> None:
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data, start=1):
            _check_numbers(key, f"a key of {name}")
            _check_numbers(value, f"{name}: {key}")
    elif isinstance(data, int | float):
        if not (math.isfinite(data) if isinstance(data, float) else abs(data) <= INTEGER_MAX):
            raise ValueError(f"{name} is no finite number of at most 128 bits")
