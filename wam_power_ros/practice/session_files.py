# SPDX-License-Identifier: Apache-2.0
"""Files of a session other than its log: header, candidates, context of the task, lock."""

from __future__ import annotations

import fcntl
import os
import platform
import re
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from wam_power_ros import durable_files, plain_json, plain_yaml
from wam_power_ros.learning import policy as policy_module
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.settings import SessionSettings

_PACKAGES = ("numpy", "scipy", "pydantic", "pin", "mujoco", "rosbags", "ros-jazzy-rclpy")


class SessionError(ValueError):
    """A session folder cannot be used; the message has the reason."""


class SessionHeader(BaseModel):
    """Contents of session.yaml.

    Attributes:
        schema_: Version of this layout ("schema" in YAML).
        seed: Seed of the exploration, and of the simulator in simulation.
        settings: Settings of practice, task and learner.
        candidates: Ids of the candidate policies, in their order.
        demonstrations: Bags that the candidates were fitted to, as given.
        versions: Versions of the software at the beginning, see `versions`.
        resumed: Versions at each resumption that changed them, oldest first.
        clock: Wall-clock figures, such as the time of the beginning.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    schema_: Literal["wam_power_ros/session/2"] = Field(
        default="wam_power_ros/session/2", alias="schema"
    )
    seed: int = Field(ge=0)
    settings: SessionSettings
    candidates: list[str] = Field(min_length=1)
    demonstrations: list[str]
    versions: dict[str, str]
    resumed: list[dict[str, str]] = Field(default_factory=list)
    clock: dict[str, Any]

    @field_validator("candidates")
    @classmethod
    def _are_ids(cls, candidates: list[str]) -> list[str]:
        for id in candidates:
            policy_module.check_id(id)  # ids are file names
        return candidates


def versions() -> dict[str, str]:
    """Versions of Python, this package and its numerical dependencies, as far as installed."""
    found = {"python": platform.python_version()}
    for name in ("wam_power_ros", *_PACKAGES):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def read_head(folder: Path) -> tuple[SessionHeader, tuple[Policy, ...], dict[str, Any]]:
    """Header, candidates and context of a session.

    Raises:
        SessionError: There is no session, or a file is malformed; names the file.
    """
    path = folder / "session.yaml"
    if not path.is_file():
        raise SessionError(f"{folder} holds no session: there is no session.yaml")
    for needed in (path, folder / "task.json"):
        check_regular(needed)
    try:
        header = SessionHeader.model_validate(plain_yaml.read(path))
    except ValidationError as error:
        raise SessionError(f"{path}: {brief(error)}") from error
    except ValueError as error:  # names the file
        raise SessionError(brief(error)) from error
    candidates = []
    for id in header.candidates:
        path = folder / "candidates" / f"{id}.json"
        check_regular(path)
        try:
            candidate = policy_module.from_json(path.read_text(encoding="utf-8"))
        except (ValueError, OSError) as error:
            raise SessionError(f"{path}: {error}") from error
        if candidate.id != id:
            raise SessionError(f"{path}: holds policy {candidate.id!r}, expected {id!r}")
        candidates.append(candidate)
    path = folder / "task.json"
    try:
        context = plain_json.read(path)
    except (ValueError, OSError) as error:
        raise SessionError(brief(error)) from error
    return header, tuple(candidates), context


def write_header(folder: Path, header: SessionHeader) -> None:
    """Replace session.yaml atomically."""
    text = yaml.safe_dump(header.model_dump(mode="json", by_alias=True), sort_keys=False)
    durable_files.replace(folder / "session.yaml", text)


def check_regular(path: Path) -> None:
    """Raise SessionError if a path is not a regular file."""
    try:
        durable_files.check_regular(path)
    except ValueError as error:
        raise SessionError(str(error)) from None


def brief(error: Exception) -> str:
    """Message of an error in one line; of a validation error, the first fault."""
    if isinstance(error, ValidationError):
        first, *others = error.errors()
        where = ".".join(str(part) for part in first["loc"]) or "file"
        more = f" (and {len(others)} more)" if others else ""
        rule = first["msg"].removeprefix("Value error, ")
        return f"{where}: {rule}, got {str(first['input'])[:80]}{more}"
    return re.sub(r"\s+", " ", str(error))


def lock(folder: Path) -> int:
    """Lock a folder; the lock is held until the returned descriptor is closed or the process ends.

    Raises:
        SessionError: Another process has locked it.
    """
    file = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(file)
        raise SessionError(f"{folder} is being written by another learner") from error
    return file
