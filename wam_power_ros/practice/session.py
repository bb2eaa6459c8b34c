# SPDX-License-Identifier: Apache-2.0
"""A session on disk: nothing learnt is ever lost.

    session.yaml     everything needed to run it again; written last, so it is complete or absent
    candidates/      the policies fitted to the demonstrations, one JSON file each
    task.json        what the task must remember of the demonstrations, see `Task.context_of`
    rollouts.jsonl   one `Record`, `Rating` or `NewDemonstration` a line, append-only, on disk
                     before it is acknowledged
    acknowledged.json  size and SHA-256 of the log when a line was last acknowledged: a log that is
                     missing, shorter or other than that was damaged
    policy.json      the best policy so far, replaced atomically
    bags/            recordings
    .lock            held while a learner writes

Kill anything at any moment: `Session.open(folder).practice(arm)` goes on bit-identically.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import logging
import os
import platform
import re
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from wam_power_ros import durable_files
from wam_power_ros.learning import policy as policy_module
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.practice import ArmModel, Practice, check_candidates
from wam_power_ros.practice.session_log import (
    Line,
    NewDemonstration,
    Rating,
    Record,
    line_of,
    with_ratings,
)
from wam_power_ros.practice.settings import SessionSettings
from wam_power_ros.tasks.task import Task

_PACKAGES = ("numpy", "scipy", "pydantic", "pin", "mujoco", "rosbags", "ros-jazzy-rclpy")
ACKNOWLEDGED = "acknowledged.json"
RESTORE = "Restore it from a backup; nothing was changed."
_LINE_MAX = 1_000_000  # bytes of a record, far more than any has

_log = logging.getLogger(__name__)


class SessionError(ValueError):
    """A session folder that cannot be used, and why."""


class _Acknowledged(BaseModel):
    """Contents of acknowledged.json.

    Attributes:
        rollouts: Number of rollouts in the log.
        bytes: Size of the log [byte].
        sha256: Digest of the log, hexadecimal.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    rollouts: int = Field(ge=0)
    bytes: int = Field(ge=0)
    sha256: str = Field(pattern="^[0-9a-f]{64}$")


class SessionHeader(BaseModel):
    """Contents of session.yaml.

    Attributes:
        schema_: Version of this layout ("schema" in YAML).
        seed: Seed of the exploration (and of the stand-in, where there is one).
        settings: Settings of practice, task and learner.
        candidates: Ids of the candidate policies, in their order.
        demonstrations: Bags they were fitted to, as given.
        versions: Versions of the software that began it, see `versions`.
        resumed: Other versions that it was resumed with, one entry a change, oldest first.
        clock: Wall-clock figures, such as when it began.
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
            policy_module.check_id(id)  # they become file names
        return candidates


def versions() -> dict[str, str]:
    """Versions of Python, this package and what it computes with; what is missing is left out."""
    found = {"python": platform.python_version()}
    for name in ("wam_power_ros", *_PACKAGES):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


class Session:
    """A session folder, held for writing; close it, or use it as a context manager.

    Attributes:
        folder: Folder of the session.
        header: Contents of session.yaml.
        context: Contents of task.json.
        candidates: Policies it began with.
        bags: Folder for the recordings.
    """

    def __init__(self, folder: Path, lock: int) -> None:
        """Use `begin` or `open`."""
        self.folder = folder
        self.bags = folder / "bags"
        self._lock = lock
        self.header, self.candidates, self.context = _read_head(folder)
        self._log, data = _read_log(folder)
        self._size, self._digest = len(data), hashlib.sha256(data)
        self._file = self._open_log()
        self._compare_versions()
        if self._log and _acknowledged(folder) != self._to_acknowledge():
            self._acknowledge()  # of a session that was killed before it could, or has none

    @staticmethod
    def exists(folder: Path | str) -> bool:
        """Whether a session was begun in a folder, so that it is to be opened."""
        return (Path(folder) / "session.yaml").is_file()

    @staticmethod
    def task_of(folder: Path | str) -> str:
        """Name of the task of a session.

        Raises:
            SessionError: No session, or a malformed one.
        """
        return _read_head(Path(folder))[0].settings.task

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
        clock: Mapping[str, Any] | None = None,
    ) -> Session:
        """Begin a session in a new folder, or in one whose beginning was interrupted.

        Args:
            folder: Becomes the session; missing parents are made.
            settings: Settings of the session.
            seed: Seed of the exploration.
            candidates: Policies fitted to the demonstrations.
            context: Data of them that the task keeps, see `Task.context_of`.
            demonstrations: Bags the candidates were fitted to.
            clock: Wall-clock figures.

        Raises:
            SessionError: There is a session already, or another process holds the folder.
            ValueError: `Practice` would refuse the arguments.
        """
        check_candidates(candidates, settings.practice)
        folder = Path(folder)
        new = [folder, *(parent for parent in folder.parents if not parent.exists())]
        folder.mkdir(parents=True, exist_ok=True)
        lock = _lock(folder)
        try:
            if cls.exists(folder) or (folder / "rollouts.jsonl").exists():
                raise SessionError(f"{folder} holds a session already; open it, or name another")
            header = SessionHeader(
                seed=seed,
                settings=settings,
                candidates=[policy.id for policy in candidates],
                demonstrations=list(demonstrations),
                versions=versions(),
                clock=dict(clock or {}),
            )
            (folder / "candidates").mkdir(exist_ok=True)
            (folder / "bags").mkdir(exist_ok=True)
            for policy in candidates:
                path = folder / "candidates" / f"{policy.id}.json"
                durable_files.replace(path, policy_module.to_json(policy))
            durable_files.replace(folder / "task.json", json.dumps(dict(context or {})) + "\n")
            _write_header(folder, header)
            for each in new:
                durable_files.sync(each.parent)
            return cls(folder, lock)
        except BaseException:
            os.close(lock)
            raise

    @classmethod
    def open(cls, folder: Path | str) -> Session:
        """Go on with a session. A last line torn by a crash is cut off, with a warning.

        Other versions of the software than those it was begun with are a warning, and are recorded.

        Raises:
            SessionError: No session, one that another process holds, a malformed file, or a log
                that is missing or not what was acknowledged; names the file and line.
        """
        folder = Path(folder)
        if not cls.exists(folder):
            raise SessionError(f"{folder} holds no session: there is no session.yaml")
        lock = _lock(folder)
        try:
            return cls(folder, lock)
        except BaseException:
            os.close(lock)
            raise

    @property
    def settings(self) -> SessionSettings:
        """Settings of the session."""
        return self.header.settings

    @property
    def seed(self) -> int:
        """Seed of the exploration."""
        return self.header.seed

    @property
    def log(self) -> tuple[Line, ...]:
        """All lines on disk, oldest first."""
        return tuple(self._log)

    @property
    def records(self) -> tuple[Record, ...]:
        """The rollouts on disk, oldest first, with their ratings."""
        return with_ratings(self._log)

    def practice(self, arm: ArmModel) -> Practice:
        """The practice as it was after the last line on disk.

        Args:
            arm: Model of the arm it goes on with.

        Raises:
            SessionError: The rollouts are not those of this session's settings and seed.
        """
        try:
            return Practice.of(
                self.settings, self.context, self.candidates, self.seed, arm, self._log
            )
        except ValueError as error:
            raise SessionError(f"{self.folder / 'rollouts.jsonl'}: {error}") from error

    def append(self, entry: Line) -> None:
        """Put a rollout, or what a person did, on disk; when this returns, it is there to stay.

        Raises:
            SessionError: Not the next rollout, or something that takes effect at another time.
            OSError: It could not be written; the log is as it was, as far as the disk allows.
        """
        if self._file is None:
            raise SessionError(f"{self.folder} is closed")
        if why := _out_of_place(entry, self._count):
            raise SessionError(f"{why} in {self.folder}")
        line = (entry.to_json() + "\n").encode()
        if len(line) > _LINE_MAX:
            raise SessionError(f"a line of {len(line)} bytes, over {_LINE_MAX}")
        try:
            _write_all(self._file, line)
            os.fsync(self._file)
        except OSError:
            os.ftruncate(self._file, self._size)
            raise
        self._size += len(line)
        self._digest.update(line)
        self._log.append(entry)
        self._acknowledge()

    def save_policy(self, policy: Policy) -> None:
        """Replace policy.json, atomically: a reader sees the old or the new one, never a part."""
        durable_files.replace(self.folder / "policy.json", policy_module.to_json(policy))

    def close(self) -> None:
        """Release the folder. Closing twice is fine."""
        if self._file is not None:
            os.close(self._file)
            os.close(self._lock)
            self._file = None

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def _count(self) -> int:
        return sum(isinstance(line, Record) for line in self._log)

    def _to_acknowledge(self) -> _Acknowledged:
        digest = self._digest.hexdigest()
        return _Acknowledged(rollouts=self._count, bytes=self._size, sha256=digest)

    def _acknowledge(self) -> None:
        """Note what the log holds, so that its loss is seen; the log itself is on disk already."""
        path = self.folder / ACKNOWLEDGED
        try:
            durable_files.replace(path, self._to_acknowledge().model_dump_json() + "\n")
        except OSError as error:
            _log.warning("%s could not be written: %s", path, error)

    def _compare_versions(self) -> None:
        """Warn of other versions than those the session began with, and record them."""
        begun, now = self.header.versions, versions()
        changed = [
            f"{name} {begun.get(name, 'none')}, now {now.get(name, 'none')}"
            for name in sorted(begun.keys() | now.keys())
            if begun.get(name) != now.get(name)
        ]
        if changed:
            _log.warning(
                "%s was begun with other versions: %s. Its next policies may differ from those it "
                "would have had",
                self.folder,
                "; ".join(changed),
            )
        if now != [begun, *self.header.resumed][-1]:
            resumed = [*self.header.resumed, now]
            self.header = self.header.model_copy(update={"resumed": resumed})
            _write_header(self.folder, self.header)

    def _open_log(self) -> int | None:
        path = self.folder / "rollouts.jsonl"
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        torn = os.fstat(file).st_size - self._size
        if torn:
            _log.warning(
                "%s: cut off %d bytes after line %d: a rollout was being written when the "
                "session ended; it was never acknowledged and is run again",
                path,
                torn,
                len(self._log),
            )
            os.ftruncate(file, self._size)
        os.fsync(file)
        durable_files.sync(self.folder)
        return file


def read_task(folder: Path | str) -> Task:
    """The task of a session, for reports.

    Raises:
        SessionError: As `read`, or its task or context is not acceptable.
    """
    header, _, context = _read_head(Path(folder))
    try:
        return header.settings.make_task(context)
    except (ValueError, KeyError) as error:
        raise SessionError(f"{folder}: {error}") from error


def read(folder: Path | str) -> tuple[SessionHeader, tuple[Policy, ...], tuple[Record, ...]]:
    """Header, candidates and rollouts of a session, for looking at: nothing is locked or changed.

    Candidates include those given later; rollouts have their ratings. A learner may be writing
    meanwhile; a line not yet complete is not returned.

    Raises:
        SessionError: No session, or a malformed file; names the file and line.
    """
    header, candidates, log = _read(folder)
    later = [line.candidate() for line in log if isinstance(line, NewDemonstration)]
    return header, (*candidates, *later), with_ratings(log)


def read_log(folder: Path | str) -> tuple[Line, ...]:
    """All lines of a session's log, for looking at.

    Raises:
        SessionError: As `read`.
    """
    return tuple(_read(folder)[2])


def _read(folder: Path | str) -> tuple[SessionHeader, tuple[Policy, ...], list[Line]]:
    folder = Path(folder)
    if not Session.exists(folder):
        raise SessionError(f"{folder} holds no session: there is no session.yaml")
    header, candidates, _ = _read_head(folder)
    log, _ = _read_log(folder)
    return header, candidates, log


def _read_head(folder: Path) -> tuple[SessionHeader, tuple[Policy, ...], dict[str, Any]]:
    path = folder / "session.yaml"
    for needed in (path, folder / "task.json"):
        _check_regular(needed)
    try:
        header = SessionHeader.model_validate(yaml.safe_load(path.read_text(encoding="utf-8")))
    except (ValidationError, yaml.YAMLError, UnicodeDecodeError) as error:
        raise SessionError(f"{path}: {_brief(error)}") from error
    candidates = []
    for id in header.candidates:
        path = folder / "candidates" / f"{id}.json"
        _check_regular(path)
        try:
            candidate = policy_module.from_json(path.read_text(encoding="utf-8"))
        except (ValueError, OSError) as error:
            raise SessionError(f"{path}: {error}") from error
        if candidate.id != id:
            raise SessionError(f"{path}: holds policy {candidate.id!r}, expected {id!r}")
        candidates.append(candidate)
    path = folder / "task.json"
    try:
        context = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError) as error:
        raise SessionError(f"{path}: {_brief(error)}") from error
    return header, tuple(candidates), context


def _write_header(folder: Path, header: SessionHeader) -> None:
    text = yaml.safe_dump(header.model_dump(mode="json", by_alias=True), sort_keys=False)
    durable_files.replace(folder / "session.yaml", text)


def _check_regular(path: Path) -> None:
    try:
        durable_files.check_regular(path)
    except ValueError as error:
        raise SessionError(str(error)) from None


def _read_log(folder: Path) -> tuple[list[Line], bytes]:
    """Complete lines of a log, and their bytes; they are at least what was acknowledged."""
    path = folder / "rollouts.jsonl"
    noted = _acknowledged(folder)  # first: a learner may be writing
    data = b""
    if path.is_symlink() or path.exists():
        _check_regular(path)
        data = path.read_bytes()
    # A line without its end was never acknowledged, whatever is in it.
    size = data.rfind(b"\n") + 1
    log: list[Line] = []
    count = 0
    for number, text in enumerate(data[:size].split(b"\n")[:-1], start=1):
        try:
            line = line_of(text.decode())
        except ValueError as error:
            raise SessionError(f"{path}, line {number}: {_brief(error)}") from error
        if why := _out_of_place(line, count):
            raise SessionError(f"{path}, line {number}: {why}")
        count += isinstance(line, Record)
        log.append(line)
    if noted is not None and (
        len(data) < noted.bytes or hashlib.sha256(data[: noted.bytes]).hexdigest() != noted.sha256
    ):
        there = f"has {len(data)} bytes" if len(data) < noted.bytes else "has other contents"
        raise SessionError(
            f"{path} {there if path.exists() else 'is missing'}: {noted.rollouts} rollouts in "
            f"{noted.bytes} bytes were acknowledged, and some of them are lost. {RESTORE} To go on "
            f"with what is left, delete {folder / ACKNOWLEDGED}"
        )
    if len(data) - size > _LINE_MAX:
        raise SessionError(f"{path}: {len(data) - size} bytes after line {len(log)} are no rollout")
    if not count and noted is None and (folder / "policy.json").exists():
        raise SessionError(
            f"{path} has no rollout, but {folder / 'policy.json'} is the best of some: they are "
            f"lost. {RESTORE} To begin again with the same demonstrations, delete policy.json"
        )
    return log, data[:size]


def _acknowledged(folder: Path) -> _Acknowledged | None:
    """What was acknowledged last; None for a session without a rollout, or of earlier versions."""
    path = folder / ACKNOWLEDGED
    if not (path.is_symlink() or path.exists()):
        return None
    _check_regular(path)
    try:
        return _Acknowledged.model_validate_json(path.read_bytes())
    except ValidationError as error:
        raise SessionError(f"{path}: {_brief(error)}") from None


def _out_of_place(line: Line, count: int) -> str:
    """Why a line cannot come after `count` rollouts, empty if it can."""
    if isinstance(line, Record):
        wrong = line.number != count + 1
        return f"rollout {line.number} cannot follow {count}" if wrong else ""
    if isinstance(line, Rating) and line.rollout > count:
        return f"rollout {line.rollout} is rated before it is on record"
    if line.after in (count, count + 1):
        return ""
    return f"what takes effect after rollout {line.after} cannot follow {count}"


def _brief(error: Exception) -> str:
    """First thing wrong, in one line."""
    if isinstance(error, ValidationError):
        first, *others = error.errors()
        where = ".".join(str(part) for part in first["loc"]) or "file"
        more = f" (and {len(others)} more)" if others else ""
        rule = first["msg"].removeprefix("Value error, ")
        return f"{where}: {rule}, got {str(first['input'])[:80]}{more}"
    if isinstance(error, json.JSONDecodeError):
        return f"not JSON: {error}"
    return re.sub(r"\s+", " ", str(error))


def _lock(folder: Path) -> int:
    """Descriptor that holds the folder until it is closed, by whatever ends the process."""
    file = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(file)
        raise SessionError(f"{folder} is being written by another learner") from error
    return file


def _write_all(file: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(file, view) :]
