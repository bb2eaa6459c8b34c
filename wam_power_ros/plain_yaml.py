# SPDX-License-Identifier: Apache-2.0
"""Plain data from YAML files; large, deep or circular YAML is refused."""

from __future__ import annotations

from pathlib import Path

import yaml

from wam_power_ros import durable_files

SIZE_MAX = 1_000_000  # largest file [byte]
DEPTH_MAX = 20  # largest number of nested levels
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # builds plain data, runs nothing


def read(file: Path, loader: type = LOADER) -> object:
    """Return the plain data in a YAML file, as `loader` builds it.

    Raises:
        ValueError: As for `parse`, or it is not a regular file or too large.
    """
    return parse(durable_files.read(file, SIZE_MAX), str(file), loader)


def parse(text: bytes, where: str, loader: type = LOADER) -> object:
    """Return the plain data in YAML text; `where` names its origin in messages.

    Raises:
        ValueError: It is nested too deeply, has a reference, or is not YAML that `loader` accepts.
    """
    depth = 0
    try:
        decoded = text.decode()
        for event in yaml.parse(decoded, Loader=loader):
            if isinstance(event, yaml.AliasEvent):
                line = event.start_mark.line + 1
                raise ValueError(f"{where}, line {line}: references (*name) are refused")
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEPTH_MAX:
                raise ValueError(f"{where} is nested deeper than {DEPTH_MAX} levels")
        return yaml.load(decoded, Loader=loader)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{where} is not plain YAML: {' '.join(str(error).split())}") from None
