# SPDX-License-Identifier: Apache-2.0
"""Plain data from the YAML files of bags and sessions; large, deep or circular YAML is refused."""

from __future__ import annotations

from pathlib import Path

import yaml

from wam_power_ros import durable_files

SIZE_MAX = 1_000_000  # largest file [byte]
DEPTH_MAX = 20  # largest number of nested levels
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # builds plain data, runs nothing


def read(file: Path) -> object:
    """Return the plain data in a YAML file.

    Raises:
        ValueError: If it is not a regular file, too large, nested too deeply, has an alias, or is
            not YAML.
    """
    return parse(durable_files.read(file, SIZE_MAX), str(file))


def parse(text: bytes, where: str) -> object:
    """Return the plain data in YAML text; `where` names its origin in messages.

    Raises:
        ValueError: If it is nested too deeply, has an alias, or is not YAML.
    """
    depth = 0
    try:
        decoded = text.decode()
        for event in yaml.parse(decoded, Loader=LOADER):
            if isinstance(event, yaml.AliasEvent):
                raise ValueError(f"{where} has an alias, which is not allowed")
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEPTH_MAX:
                raise ValueError(f"{where} is nested deeper than {DEPTH_MAX} levels")
        return yaml.load(decoded, Loader=LOADER)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{where} is not plain YAML: {error}") from None
