# SPDX-License-Identifier: Apache-2.0
"""Session folder: everything learnt is on disk at any moment.

    session.yaml     settings and seed; written last when a session begins, so it marks a complete
                     session
    candidates/      policies fitted to the demonstrations, one JSON file each
    task.json        data of the demonstrations that the task needs, see `Task.context_of`
    rollouts.jsonl   one `Record`, `Rating`, `NewDemonstration` or `Pause` per line, append-only, on
                     disk before it is acknowledged
    acknowledged.json  size and SHA-256 of the log at the last acknowledgement; a log that is
                     missing, shorter or different is damaged
    policy.json      best policy so far, replaced atomically
    bags/            recordings
    .lock            locked while a learner writes

After a kill at any moment, `Session.open(folder).practice(arm)` resumes bit for bit.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from wam_power_ros import durable_files, plain_json, plain_yaml
from wam_power_ros.arm_identity import ArmIdentity, refusal
from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.improvement import ArmModel
from wam_power_ros.practice.log_file import LogFile, read_lines
from wam_power_ros.practice.practice import Practice, check_candidates
from wam_power_ros.practice.session_log import Line, NewDemonstration, Record, with_ratings
from wam_power_ros.practice.settings import SessionSettings, in_one_line
from wam_power_ros.tasks.task import Task

PACKAGES = ("numpy", "scipy", "pydantic", "pin", "mujoco", "rosbags", "ros-jazzy-rclpy")


def read_policy(path: Path, arm: ArmIdentity) -> Policy:
    """Read a saved policy of an arm.

    Raises:
        ValueError: The file is not a policy, or one of another arm.
        OSError: It cannot be read.
    """
    try:
        policy = policies.from_json(path.read_text(encoding="utf-8"))
    except ValueError as error:  # also of bytes that are no text
        raise ValueError(f"{path} is not a policy: {error}") from None
    if why := refusal(policy.arm, arm):
        raise ValueError(f"{path}: policy {policy.id} {why}")
    return policy


class SessionHeader(BaseModel):
    """Contents of session.yaml.

    Attributes:
        seed: Seed of the exploration and the simulator.
        settings: Settings of practice, task and learner.
        candidates: Ids of the candidate policies, in their order.
        demonstrations: Bags that the candidates were fitted to, as given.
        versions: Versions of the software at the beginning, see `versions`.
        resumed: Versions at each resumption that changed them, oldest first.
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
            policies.check_id(id)  # ids are file names
        return candidates


def versions() -> dict[str, str]:
    """Versions of Python, this package and its numerical dependencies, as far as installed."""
    found = {"python": platform.python_version()}
    for name in ("wam_power_ros", *PACKAGES):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def _read_head(folder: Path) -> tuple[SessionHeader, tuple[Policy, ...], dict[str, Any]]:
    """Header, candidates and context of a session.

    Raises:
        ValueError: There is no session, or a file is malformed; names the file.
    """
    durable_files.check_name(folder)
    path = folder / "session.yaml"
    if not path.is_file():
        raise ValueError(f"{folder} holds no session: there is no session.yaml")
    try:
        header = SessionHeader.model_validate(plain_yaml.read(path))
    except ValidationError as error:
        raise ValueError(f"{path}: {in_one_line(error)}") from None
    candidates = []
    for id in header.candidates:
        path = folder / "candidates" / f"{id}.json"
        durable_files.check_regular(path)
        try:
            candidate = policies.from_json(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        if candidate.id != id:
            raise ValueError(f"{path}: holds policy {candidate.id!r}, expected {id!r}")
        candidates.append(candidate)
    return header, tuple(candidates), plain_json.read(folder / "task.json")


def _write_header(folder: Path, header: SessionHeader) -> None:
    """Replace session.yaml atomically."""
    text = yaml.safe_dump(header.model_dump(mode="json", by_alias=True), sort_keys=False)
    durable_files.replace(folder / "session.yaml", text)


class Session:
    """A session folder, read by `read` or locked for writing by `begin` and `open`.

    Close a locked one, or use it as a context manager.

    Attributes:
        header: Contents of session.yaml.
        context: Contents of task.json.
        candidates: Policies that the session began with.
        log: Lines of the log, oldest first.
    """

    def __init__(self, folder: Path, lock: int | None = None) -> None:
        """Use `begin`, `open` or `read`; `lock` is the locked descriptor of the folder."""
        self.folder = folder
        self.header, self.candidates, self.context = _read_head(folder)
        self._lock = lock
        self._saved = ""  # text of the policy saved last
        self._file = None if lock is None else LogFile(folder)
        self.log = read_lines(folder)[0] if self._file is None else self._file.lines
        if self._file is not None:
            self._compare_versions()

    @staticmethod
    def exists(folder: Path | str) -> bool:
        """Whether a folder holds a session, to be opened instead of begun."""
        return (Path(folder) / "session.yaml").is_file()

    @classmethod
    def begin(
        cls,
        folder: Path | str,
        settings: SessionSettings,
        seed: int,
        candidates: Sequence[Policy],
        *,
        context: Mapping[str, Any] | None = None,
        demonstrations: Sequence[str] = (),
    ) -> Session:
        """Begin a session in a new folder, or in one whose creation was interrupted.

        Args:
            folder: Folder of the session; created with its parents.
            settings: Settings of the session.
            seed: Seed of the exploration.
            candidates: Policies fitted to the demonstrations.
            context: Data of the demonstrations that the task needs, see `Task.context_of`.
            demonstrations: Bags that the candidates were fitted to.

        Raises:
            ValueError: The folder holds a session already, or another process has locked it.
            ValueError: `check_candidates` refuses the candidates.
        """
        check_candidates(candidates, settings.practice)
        folder = Path(folder)
        new = [folder, *(parent for parent in folder.parents if not parent.exists())]
        folder.mkdir(parents=True, exist_ok=True)
        with _locked(folder) as lock:
            if cls.exists(folder) or (folder / "rollouts.jsonl").exists():
                raise ValueError(f"{folder} holds a session already; open it, or name another")
            header = SessionHeader(
                seed=seed,
                settings=settings,
                candidates=[policy.id for policy in candidates],
                demonstrations=list(demonstrations),
                versions=versions(),
                clock={},
            )
            (folder / "candidates").mkdir(exist_ok=True)
            (folder / "bags").mkdir(exist_ok=True)
            for policy in candidates:
                path = folder / "candidates" / f"{policy.id}.json"
                durable_files.replace(path, policies.to_json(policy))
            durable_files.replace(folder / "task.json", json.dumps(dict(context or {})) + "\n")
            _write_header(folder, header)
            for each in new:
                durable_files.sync(each.parent)
            return cls(folder, lock)

    @classmethod
    def open(cls, folder: Path | str) -> Session:
        """Open a session to resume it; an incomplete last line is cut off, with a warning.

        If versions of the software differ from those at the beginning, they are recorded, with a
        warning.

        Raises:
            ValueError: There is no session, another process has locked it, a file is malformed,
                or the log has lost acknowledged lines; names the file and line.
        """
        folder = Path(folder)
        if not cls.exists(folder):
            raise ValueError(f"{folder} holds no session: there is no session.yaml")
        with _locked(folder) as lock:
            return cls(folder, lock)

    @property
    def records(self) -> tuple[Record, ...]:
        """The rollouts on disk, oldest first, with their ratings."""
        return with_ratings(self.log)

    @property
    def policies(self) -> tuple[Policy, ...]:
        """Policies of all demonstrations, including those added later."""
        added = (line.candidate() for line in self.log if isinstance(line, NewDemonstration))
        return (*self.candidates, *added)

    @cached_property
    def task(self) -> Task:
        """Task of the session.

        Raises:
            ValueError: Its context is malformed.
        """
        try:
            return self.header.settings.make_task(self.context)
        except (ValueError, KeyError) as error:
            raise ValueError(f"{self.folder}: {error}") from error

    def practice(self, arm: ArmModel) -> Practice:
        """The practice as it was after the last line on disk.

        Args:
            arm: Model of the arm for the rest of the session.

        Raises:
            ValueError: The log does not follow from this session's settings and seed.
        """
        try:
            settings, seed = self.header.settings, self.header.seed
            return Practice(settings, self.context, self.candidates, seed, arm, self.log)
        except ValueError as error:
            raise ValueError(f"{self.folder / 'rollouts.jsonl'}: {error}") from error

    def append(self, entry: Line) -> None:
        """Append a line to the log; see `LogFile.append`.

        Raises:
            ValueError: The session is not locked for writing, or as `LogFile.append`.
        """
        if self._file is None:
            raise ValueError(f"session {self.folder} is closed")
        self._file.append(entry)

    def save_policy(self, policy: Policy) -> None:
        """Replace policy.json atomically, if it is another than the one saved last."""
        if (text := policies.to_json(policy)) != self._saved:
            durable_files.replace(self.folder / "policy.json", text)
            self._saved = text

    def close(self) -> None:
        """Unlock the folder; may be called twice."""
        if self._file is not None and self._lock is not None:
            self._file.close()
            os.close(self._lock)
            self._file = self._lock = None

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _compare_versions(self) -> None:
        """Warn of versions that differ from those at the beginning, and record them."""
        begun, now = self.header.versions, versions()
        changed = [
            f"{name} {begun.get(name, 'none')}, now {now.get(name, 'none')}"
            for name in sorted(begun.keys() | now.keys())
            if begun.get(name) != now.get(name)
        ]
        if changed:
            logging.getLogger(__name__).warning(
                "%s was begun with other versions: %s. Its next policies may differ from those "
                "with the old versions",
                self.folder,
                "; ".join(changed),
            )
        if now != [begun, *self.header.resumed][-1]:
            resumed = [*self.header.resumed, now]
            self.header = self.header.model_copy(update={"resumed": resumed})
            _write_header(self.folder, self.header)


@contextmanager
def _locked(folder: Path) -> Iterator[int]:
    """Lock a folder, until the descriptor is closed, the process ends or the block fails.

    Raises:
        ValueError: Another process has locked it.
    """
    file = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise ValueError(f"{folder} is being written by another learner") from error
        yield file
    except BaseException:
        os.close(file)
        raise


def read(folder: Path | str) -> Session:
    """Read a session without locking or changing it.

    A learner may be writing meanwhile; an incomplete line is not returned.

    Raises:
        ValueError: There is no session, or a file is malformed; names the file and line.
    """
    return Session(Path(folder))
