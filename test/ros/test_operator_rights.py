# SPDX-License-Identifier: Apache-2.0
"""The enclave of the operator allows the commands in `docs/hardware.md`, and no others."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from fnmatch import fnmatchcase

from conftest import ROOT
from rights import RIGHTS

TYPED = re.compile(r"^ros2 (?:topic|service|lifecycle|param) .*", re.MULTILINE)
DOCS = [*sorted((ROOT / "docs").glob("*.md")), ROOT / "SECURITY.md"]
COMMANDS = sorted({line for file in DOCS for line in TYPED.findall(file.read_text())})
SERVICES = {  # verb of `ros2 lifecycle` -> services that it calls
    "set": ("get_available_transitions", "change_state"),
    "get": ("get_state",),
}


def refused(names: set[str], kind: str, right: str) -> set[str]:
    """Names that no expression matches, as the middleware matches them."""
    expressions = RIGHTS["operator"][kind, right]
    return {name for name in names if not any(fnmatchcase(name, each) for each in expressions)}


def needed(command: str) -> Iterator[tuple[str, str, str]]:
    """Kind, right and name of what a command does."""
    _, group, verb, name, *_ = shlex.split(command, comments=True)
    if group == "topic":
        yield "topic", "publish" if verb == "pub" else "subscribe", name
    elif group == "service":
        yield "service", "request", name
    else:
        yield from (("service", "request", f"{name}/{each}") for each in SERVICES[verb])


def test_a_documented_command_is_within_the_rights_of_the_operator() -> None:
    assert {command.split()[1] for command in COMMANDS} >= {"topic", "service", "lifecycle"}
    for command in COMMANDS:
        for kind, right, name in needed(command):
            assert refused({name}, kind, right) == set(), command


def test_torques_and_policies_are_not() -> None:
    assert refused({"/effort_controller/commands", "/policy"}, "topic", "publish")
    assert refused({"/torque_controller/set_parameters"}, "service", "request")
