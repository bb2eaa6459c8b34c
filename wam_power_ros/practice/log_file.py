# SPDX-License-Identifier: Apache-2.0
"""The log of a session on disk: append-only, flushed before a line is acknowledged.

rollouts.jsonl     one `Record`, `Rating` or `NewDemonstration` a line
acknowledged.json  its size and SHA-256 when a line was last acknowledged: a log that is
missing, shorter or other than that was damaged
"""

from __future__ import annotations

import hashlib
import logging
import os
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from wam_power_ros import durable_files
from wam_power_ros.practice.session_files import SessionError, brief, check_regular
from wam_power_ros.practice.session_log import Line, Rating, Record, line_of

ACKNOWLEDGED = "acknowledged.json"
RESTORE = "Restore it from a backup; nothing was changed."
_LINE_MAX = 1_000_000  # bytes of a record, far more than any has

_log = logging.getLogger(__name__)


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


class LogFile:
    """Log of a session, open for appending; the folder must be locked.

    Attributes:
        lines: Lines on disk, oldest first.
    """

    def __init__(self, folder: Path) -> None:
        """Read and open the log of a folder; a last line torn by a crash is cut off.

        Raises:
            SessionError: It is malformed, or not what was acknowledged.
        """
        self.folder = folder
        self.lines, data = read_lines(folder)
        self._size, self._digest = len(data), hashlib.sha256(data)
        self._file: int | None = self._open()
        if self.lines and _acknowledged(folder) != self._to_acknowledge():
            self._acknowledge()  # of a session that was killed before it could, or has none

    def append(self, entry: Line) -> None:
        """Put a line on disk; when this returns, it is there to stay.

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
        self.lines.append(entry)
        self._acknowledge()

    def close(self) -> None:
        """Close the file; closing twice is fine."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    @property
    def _count(self) -> int:
        return sum(isinstance(line, Record) for line in self.lines)

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

    def _open(self) -> int:
        path = self.folder / "rollouts.jsonl"
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        torn = os.fstat(file).st_size - self._size
        if torn:
            _log.warning(
                "%s: cut off %d bytes after line %d: a rollout was being written when the "
                "session ended; it was never acknowledged and is run again",
                path,
                torn,
                len(self.lines),
            )
            os.ftruncate(file, self._size)
        os.fsync(file)
        durable_files.sync(self.folder)
        return file


def read_lines(folder: Path) -> tuple[list[Line], bytes]:
    """Complete lines of a log, and their bytes; they are at least what was acknowledged."""
    path = folder / "rollouts.jsonl"
    noted = _acknowledged(folder)  # first: a learner may be writing
    data = b""
    if path.is_symlink() or path.exists():
        check_regular(path)
        data = path.read_bytes()
    # A line without its end was never acknowledged, whatever is in it.
    size = data.rfind(b"\n") + 1
    log: list[Line] = []
    count = 0
    for number, text in enumerate(data[:size].split(b"\n")[:-1], start=1):
        try:
            line = line_of(text.decode())
        except ValueError as error:
            raise SessionError(f"{path}, line {number}: {brief(error)}") from error
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
    check_regular(path)
    try:
        return _Acknowledged.model_validate_json(path.read_bytes())
    except ValidationError as error:
        raise SessionError(f"{path}: {brief(error)}") from None


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


def _write_all(file: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(file, view) :]
