# SPDX-License-Identifier: Apache-2.0
"""Session log on disk: append-only, each line flushed before it is acknowledged.

The files rollouts.jsonl and acknowledged.json are described in `session`.
"""

from __future__ import annotations

import hashlib
import logging
import os
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from wam_power_ros import durable_files, plain_json
from wam_power_ros.practice.session_log import Line, Record, out_of_order, parse_line
from wam_power_ros.practice.settings import validated

LOG, ACKNOWLEDGED = "rollouts.jsonl", "acknowledged.json"
RESTORE = "Restore it from a backup; nothing was changed."
_LINE_MAX = 1_000_000  # length of a line, far above any real one [byte]

_log = logging.getLogger(__name__)


class _Acknowledged(BaseModel):
    """Contents of acknowledged.json: number of rollouts, size [byte] and SHA-256 of the log."""

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
        self.lines, data, acknowledged = read_lines(folder)
        self._size, self._digest = len(data), hashlib.sha256(data)
        self._count = sum(isinstance(line, Record) for line in self.lines)
        path = folder / LOG
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        if incomplete := os.fstat(self._file).st_size - self._size:
            _log.warning(
                "%s: cut off %d bytes after line %d: a line was being written when the session "
                "ended and was never acknowledged; if it is a rollout, it is executed again",
                path,
                incomplete,
                len(self.lines),
            )
            os.ftruncate(self._file, self._size)
        os.fsync(self._file)
        durable_files.sync(folder)
        if self.lines and acknowledged != self._state():
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
                left = memoryview(line)
                while left:
                    left = left[os.write(self._file, left) :]
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


def read_lines(folder: Path) -> tuple[list[Line], bytes, _Acknowledged | None]:
    """Read the complete lines of a log, their bytes, and what was acknowledged last.

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
