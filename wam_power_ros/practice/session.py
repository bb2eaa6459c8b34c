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
import hashlib
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
from pydantic import BaseModel, ConfigDict, Field, field_validator

from wam_power_ros import durable_files, plain_json, plain_yaml
from wam_power_ros.arm_identity import ArmIdentity, refusal
from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.learning_run import ArmModel
from wam_power_ros.practice.practice import Practice, check_candidates
from wam_power_ros.practice.session_log import (
    Line,
    NewDemonstration,
    Record,
    out_of_order,
    parse_line,
    with_ratings,
)
from wam_power_ros.practice.settings import SessionSettings, validated
from wam_power_ros.tasks.task import Task

HEADER, LOG, ACKNOWLEDGED = "session.yaml", "rollouts.jsonl", "acknowledged.json"
RESTORE = "Restore it from a backup; nothing was changed."
_LINE_MAX = 1_000_000  # length of a line of the log, far above any real one [byte]
PACKAGES = ("numpy", "scipy", "pydantic", "pin", "mujoco", "rosbags", "ros-jazzy-rclpy")

_log = logging.getLogger(__name__)


def _read_policy(path: Path) -> Policy:
    try:
        return policies.from_json(path.read_text(encoding="utf-8"))
    except ValueError as error:  # also of bytes that are no text
        raise ValueError(f"{path} is not a policy: {error}") from None


def read_policy(path: Path, arm: ArmIdentity) -> Policy:
    """Read a saved policy of an arm.

    Raises:
        ValueError: The file is not a policy, or one of another arm.
        OSError: It cannot be read.
    """
    policy = _read_policy(path)
    if why := refusal(policy.arm, arm):
        raise ValueError(f"{path}: policy {policy.id} {why}")
    return policy


class SessionHeader(BaseModel):
    """Contents of session.yaml."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    schema_: Literal["wam_power_ros/session/2"] = Field(
        default="wam_power_ros/session/2", alias="schema"
    )
    seed: int = Field(ge=0)  # of the exploration, and of the simulator in simulation
    settings: SessionSettings
    candidates: list[str] = Field(min_length=1)  # ids of the candidate policies, in their order
    demonstrations: list[str]  # bags that the candidates were fitted to, as given
    versions: dict[str, str]  # of the software at the beginning, see `versions`
    # Versions at each resumption that changed them, oldest first
    resumed: list[dict[str, str]] = Field(default_factory=list)
    clock: dict[str, Any]  # wall-clock figures; empty

    @field_validator("candidates")
    @classmethod
    def _are_ids(cls, candidates: list[str]) -> list[str]:
        for id in candidates:
            policies.check_id(id)  # ids are file names
        return candidates


class _Acknowledged(BaseModel):
    """Contents of acknowledged.json: number of rollouts, size [byte] and SHA-256 of the log."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rollouts: int = Field(ge=0)
    bytes: int = Field(ge=0)
    sha256: str = Field(pattern="^[0-9a-f]{64}$")


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
    path = folder / HEADER
    if not path.is_file():
        raise ValueError(f"{folder} holds no session: there is no {HEADER}")
    header = validated(SessionHeader, plain_yaml.read(path), f"{path}: ")
    candidates = []
    for id in header.candidates:
        path = folder / "candidates" / f"{id}.json"
        durable_files.check_regular(path)
        candidates.append(_read_policy(path))
        if candidates[-1].id != id:
            raise ValueError(f"{path}: holds policy {candidates[-1].id!r}, expected {id!r}")
    return header, tuple(candidates), plain_json.read(folder / "task.json")


def _write_header(folder: Path, header: SessionHeader) -> None:
    """Replace session.yaml atomically."""
    text = yaml.safe_dump(header.model_dump(mode="json", by_alias=True), sort_keys=False)
    durable_files.replace(folder / HEADER, text)


def _read_log(folder: Path) -> tuple[list[Line], bytes, _Acknowledged | None]:
    """Complete lines of a log, their bytes, and what was acknowledged last.

    Nothing is acknowledged of a session without a line, or of an earlier version.

    Raises:
        ValueError: The log is malformed, or has lost acknowledged lines.
    """
    path, noted, acknowledged = folder / LOG, folder / ACKNOWLEDGED, None
    if noted.is_symlink() or noted.exists():  # before the log: a learner may be writing
        acknowledged = validated(_Acknowledged, plain_json.read(noted), f"{noted}: ")
    data = b""
    if path.is_symlink() or path.exists():
        durable_files.check_regular(path)
        data = path.read_bytes()
    # A line without its line feed was never acknowledged, whatever it contains.
    size = data.rfind(b"\n") + 1
    log: list[Line] = []
    count = 0
    for number, text in enumerate(data[:size].split(b"\n")[:-1], start=1):
        try:
            line = parse_line(text.decode())
            if why := out_of_order(line, count):
                raise ValueError(why)
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from None
        count += isinstance(line, Record)
        log.append(line)
    if acknowledged is not None:
        found = ""
        if len(data) < acknowledged.bytes:
            found = f"has {len(data)} bytes" if path.exists() else "is missing"
        elif hashlib.sha256(data[: acknowledged.bytes]).hexdigest() != acknowledged.sha256:
            found = "has other contents"
        if found:
            raise ValueError(
                f"{path} {found}: {acknowledged.rollouts} rollouts in {acknowledged.bytes} bytes "
                f"were acknowledged, and some of them are lost. {RESTORE} To continue with the "
                f"rest, delete {noted}"
            )
    if len(data) - size > _LINE_MAX:
        raise ValueError(
            f"{path}: {len(data) - size} bytes after line {len(log)} are not a log line"
        )
    if not count and acknowledged is None and (folder / "policy.json").exists():
        raise ValueError(
            f"{path} has no rollout, but {folder / 'policy.json'} was learnt from some: they are "
            f"lost. {RESTORE} To begin again with the same demonstrations, delete policy.json"
        )
    return log, data[:size], acknowledged


class Session:
    """A session folder, read by `read` or locked for writing by `begin` and `open`.

    Close a locked one, or use it as a context manager.

    Attributes:
        context: Contents of task.json.
        candidates: Policies that the session began with.
        log: Lines of the log, oldest first.
    """

    def __init__(self, folder: Path, lock: int | None = None) -> None:
        """Use `begin`, `open` or `read`; `lock` is the locked descriptor of the folder."""
        self.folder = folder
        self.header, self.candidates, self.context = _read_head(folder)
        self.log, data, acknowledged = _read_log(folder)
        self._count = sum(isinstance(line, Record) for line in self.log)
        self._size, self._digest = len(data), hashlib.sha256(data)  # of the log
        self._saved = ""  # text of the policy saved last
        self._lock, self._file = lock, None
        if lock is not None:
            self._file = self._open_log()
            if self.log and acknowledged != self._state():
                self._acknowledge()  # killed before it could, or a session of an earlier version
            self._compare_versions()

    @staticmethod
    def exists(folder: Path | str) -> bool:
        """Whether a folder holds a session, to be opened instead of begun."""
        return (Path(folder) / HEADER).is_file()

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

        The candidates are policies fitted to demonstrations, which are given as bags; for the
        context see `Task.context_of`.

        Raises:
            ValueError: The folder holds a session already, another process has locked it, or
                `check_candidates` refuses the candidates.
        """
        check_candidates(candidates, settings.practice)
        folder = Path(folder)
        new = [folder, *(parent for parent in folder.parents if not parent.exists())]
        for name in ("candidates", "bags"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        with _locked(folder) as lock:
            if cls.exists(folder) or (folder / LOG).exists():
                raise ValueError(f"{folder} holds a session already; open it, or name another")
            header = SessionHeader(
                seed=seed,
                settings=settings,
                candidates=[policy.id for policy in candidates],
                demonstrations=list(demonstrations),
                versions=versions(),
                clock={},
            )
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
        _read_head(Path(folder))  # what is no session gets no lock
        with _locked(Path(folder)) as lock:
            return cls(Path(folder), lock)

    @property
    def records(self) -> tuple[Record, ...]:
        """The rollouts on disk, oldest first, with their ratings."""
        return with_ratings(self.log)

    @property
    def policies(self) -> tuple[Policy, ...]:
        """Policies of all demonstrations, including those added later."""
        added = (line.candidate() for line in self.log if isinstance(line, NewDemonstration))
        return (*self.candidates, *added)

    @property
    def start(self) -> Policy | None:
        """Policy of the demonstration that was learnt from last; None before the choice."""
        practised = [record for record in self.records if record.kind != "reproduction"]
        last = practised[-1].demonstration if practised else None
        return next((policy for policy in self.policies if policy.id == last), None)

    @cached_property
    def task(self) -> Task:
        """Task of the session; a ValueError names the folder if its context is malformed."""
        try:
            return self.header.settings.make_task(self.context)
        except (ValueError, KeyError) as error:
            raise ValueError(f"{self.folder}: {error}") from error

    def practice(self, arm: ArmModel) -> Practice:
        """The practice as it was after the last line on disk, with a model of the arm from now on.

        Raises:
            ValueError: The log does not follow from this session's settings and seed.
        """
        try:
            settings, seed = self.header.settings, self.header.seed
            return Practice(settings, self.context, self.candidates, seed, arm, self.log)
        except ValueError as error:
            raise ValueError(f"{self.folder / 'rollouts.jsonl'}: {error}") from error

    def append(self, entry: Line) -> None:
        """Append a line to the log; when this returns, it is on the disk.

        Raises:
            ValueError: The session is not locked for writing, or the line is not the next one of
                the log, or too long.
            OSError: The disk refused the line; the log is unchanged as far as the disk allows.
        """
        if self._file is None:
            raise ValueError(f"session {self.folder} is closed")
        if why := out_of_order(entry, self._count):
            raise ValueError(f"{self.folder}: {why}")
        line = (entry.to_json() + "\n").encode()
        if len(line) > _LINE_MAX:
            raise ValueError(f"{self.folder}: log line of {len(line)} bytes, limit {_LINE_MAX}")
        try:
            parse_line(line.decode())
        except ValueError as error:  # such as a ground truth nested too deeply
            raise ValueError(f"{self.folder}: line would not be readable: {error}") from None
        try:
            with durable_files.naming(self.folder / LOG):
                left = memoryview(line)
                while left:
                    left = left[os.write(self._file, left) :]
                os.fsync(self._file)
        except OSError:
            os.ftruncate(self._file, self._size)
            raise
        self._size += len(line)
        self._digest.update(line)
        self.log.append(entry)
        self._count += isinstance(entry, Record)
        self._acknowledge()

    def save_policy(self, policy: Policy) -> None:
        """Replace policy.json atomically, if it is another than the one saved last."""
        if (text := policies.to_json(policy)) != self._saved:
            durable_files.replace(self.folder / "policy.json", text)
            self._saved = text

    def close(self) -> None:
        """Unlock the folder; may be called twice."""
        if self._file is not None and self._lock is not None:
            os.close(self._file)
            os.close(self._lock)
            self._file = self._lock = None

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _open_log(self) -> int:
        """Open the log for appending; cut off an incomplete last line, left by a crash."""
        path = self.folder / LOG
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        if incomplete := os.fstat(file).st_size - self._size:
            _log.warning(
                "%s: cut off %d bytes after line %d: a line was being written when the session "
                "ended and was never acknowledged; if it is a rollout, it is executed again",
                path,
                incomplete,
                len(self.log),
            )
            os.ftruncate(file, self._size)
        os.fsync(file)
        durable_files.sync(self.folder)
        return file

    def _state(self) -> _Acknowledged:
        digest = self._digest.hexdigest()
        return _Acknowledged(rollouts=self._count, bytes=self._size, sha256=digest)

    def _acknowledge(self) -> None:
        """Write size and digest of the log, so that a loss is detected; the log is on disk."""
        path = self.folder / ACKNOWLEDGED
        try:
            with durable_files.naming(path):
                durable_files.replace(path, self._state().model_dump_json() + "\n")
        except OSError as error:
            _log.warning("could not be written: %s", durable_files.explained(error))

    def _compare_versions(self) -> None:
        """Warn of versions that differ from those at the beginning, and record them."""
        begun, now = self.header.versions, versions()
        changed = [
            f"{name} {begun.get(name, 'none')}, now {now.get(name, 'none')}"
            for name in sorted(begun.keys() | now.keys())
            if begun.get(name) != now.get(name)
        ]
        if changed:
            _log.warning(
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
    """Lock a folder, until the descriptor is closed, the process ends or the block fails."""
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
