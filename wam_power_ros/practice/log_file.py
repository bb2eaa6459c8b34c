# SPDX-License-Identifier: Apache-2.0
"""Session log on disk: append-only, each line flushed before it is acknowledged.

The files rollouts.jsonl and acknowledged.json are described in `session`.
"""

from __future__ import annotations

import hashlib
import logging
import os
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from wam_power_ros import durable_files, plain_json
from wam_power_ros.practice.session_log import Line, Record, out_of_order, parse_line
from wam_power_ros.practice.settings import in_one_line

LOG, ACKNOWLEDGED = "rollouts.jsonl", "acknowledged.json"
RESTORE = "Restore it from a backup; nothing was changed."
_LINE_MAX = 1_000_000  # length of a line, far above any real one [byte]

_log = logging.getLogger(__name__)


class _Acknowledged(BaseModel):
    """Contents of acknowledged.json.

    Attributes:
        rollouts: Number of rollouts in the log.
        bytes: Size of the log [byte].
        sha256: SHA-256 of the log, hexadecimal.
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
        """Read and open the log of a folder; truncate an incomplete last line left by a crash.

        Raises:
            ValueError: The log is malformed, or has lost acknowledged lines.
        """
        self.folder = folder
        self.lines, data = read_lines(folder)
        self._size, self._digest = len(data), hashlib.sha256(data)
        self._count = sum(isinstance(line, Record) for line in self.lines)
        self._file = self._open()
        if self.lines and _read_acknowledged(folder) != self._state():
            self._acknowledge()  # killed before it could, or a session of an earlier version

    def append(self, entry: Line) -> None:
        """Append a line; when this returns, the line is on the disk.

        Raises:
            ValueError: The line is not the next one of the log, or is too long.
            OSError: The disk refused the line; the log is unchanged as far as the disk allows.
        """
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
                _write_all(self._file, line)
                os.fsync(self._file)
        except OSError:
            os.ftruncate(self._file, self._size)
            raise
        self._size += len(line)
        self._digest.update(line)
        self.lines.append(entry)
        self._count += isinstance(entry, Record)
        self._acknowledge()

    def close(self) -> None:
        """Close the file; nothing can be appended any more."""
        os.close(self._file)

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

    def _open(self) -> int:
        path = self.folder / LOG
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        incomplete = os.fstat(file).st_size - self._size
        if incomplete:
            _log.warning(
                "%s: cut off %d bytes after line %d: a line was being written when the session "
                "ended and was never acknowledged; if it is a rollout, it is executed again",
                path,
                incomplete,
                len(self.lines),
            )
            os.ftruncate(file, self._size)
        os.fsync(file)
        durable_files.sync(self.folder)
        return file


def read_lines(folder: Path) -> tuple[list[Line], bytes]:
    """Read the complete lines of a log, and their bytes.

    Raises:
        ValueError: The log is malformed, or has lost acknowledged lines.
    """
    path = folder / LOG
    acknowledged = _read_acknowledged(folder)  # before the log: a learner may be writing
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
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from None
        if why := out_of_order(line, count):
            raise ValueError(f"{path}, line {number}: {why}")
        count += isinstance(line, Record)
        log.append(line)
    if acknowledged is not None:
        _check_acknowledged(path, data, acknowledged)
    if len(data) - size > _LINE_MAX:
        raise ValueError(
            f"{path}: {len(data) - size} bytes after line {len(log)} are not a log line"
        )
    if not count and acknowledged is None and (folder / "policy.json").exists():
        raise ValueError(
            f"{path} has no rollout, but {folder / 'policy.json'} was learnt from some: they are "
            f"lost. {RESTORE} To begin again with the same demonstrations, delete policy.json"
        )
    return log, data[:size]


def _check_acknowledged(path: Path, data: bytes, acknowledged: _Acknowledged) -> None:
    """Raise ValueError if the data of a log lack what was acknowledged."""
    if len(data) < acknowledged.bytes:
        found = f"has {len(data)} bytes" if path.exists() else "is missing"
    elif hashlib.sha256(data[: acknowledged.bytes]).hexdigest() != acknowledged.sha256:
        found = "has other contents"
    else:
        return
    raise ValueError(
        f"{path} {found}: {acknowledged.rollouts} rollouts in {acknowledged.bytes} bytes were "
        f"acknowledged, and some of them are lost. {RESTORE} To continue with the rest, delete "
        f"{path.with_name(ACKNOWLEDGED)}"
    )


def _read_acknowledged(folder: Path) -> _Acknowledged | None:
    """Last acknowledgement; None for a session without a rollout, or of an earlier version."""
    path = folder / ACKNOWLEDGED
    if not (path.is_symlink() or path.exists()):
        return None
    try:
        return _Acknowledged.model_validate(plain_json.read(path))
    except ValidationError as error:
        raise ValueError(f"{path}: {in_one_line(error)}") from None


def _write_all(file: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(file, view) :]
