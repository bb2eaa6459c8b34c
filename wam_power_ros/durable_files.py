# SPDX-License-Identifier: Apache-2.0
"""Files that survive a crash: flushed to disk and replaced atomically; errors that say which."""

from __future__ import annotations

import errno
import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_REMEDIES = {
    errno.ENOSPC: "free some space on its disk",
    errno.EDQUOT: "free some of your quota on its disk",
    errno.EFBIG: "the file may not grow any more: see `ulimit -f`",
    errno.EROFS: "its disk is read-only: choose another folder",
    errno.EACCES: "it is not yours: choose another folder, or change its rights",
}


def explained(error: OSError) -> str:
    """File of an error, reason and remedy, as far as they are known."""
    if error.strerror is None:
        return str(error)
    file = f"{printable(error.filename)}: " if error.filename else ""
    remedy = _REMEDIES.get(error.errno or 0, "")
    return f"{file}{error.strerror}{remedy and f'; {remedy}'}"


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name the file in an `OSError`, which those of writing, flushing and its parts do not."""
    try:
        yield
    except OSError as error:
        if error.errno is not None:
            error.filename, error.filename2 = str(path), None
        raise


def printable(path: Path | str) -> str:
    """Path as one line for a terminal: control characters are escaped."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(path))


def check_name(path: Path) -> None:
    """Check that a path can be printed.

    Raises:
        ValueError: It has control characters, such as a line feed or an escape sequence.
    """
    if not str(path).isprintable():
        raise ValueError(f"{printable(path)} has control characters in its name: rename it")


def check_regular(path: Path) -> None:
    """Check that a path is a regular file: reading a FIFO or a device may block or never end.

    Raises:
        ValueError: It is another kind of file, missing or a broken link.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, RuntimeError) as error:  # RuntimeError: a loop of links, before Python 3.13
        raise ValueError(f"{path}: {getattr(error, 'strerror', error)}") from None
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a FIFO, socket or device"
        raise ValueError(f"{path} is {kind}; it must be a regular file")


def read(path: Path, size_max: int) -> bytes:
    """Return the content of a file that somebody may have been given.

    Raises:
        ValueError: It is not a regular file, or larger than `size_max` [byte].
    """
    check_regular(path)
    if (size := path.stat().st_size) > size_max:
        raise ValueError(f"{path} has {size} bytes; at most {size_max} are allowed")
    return path.read_bytes()


def is_locked(path: Path) -> bool:
    """Whether a process holds the lock of a file; of one that is not there none does."""
    try:
        with path.open() as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (FileNotFoundError, NotADirectoryError):
        return False
    except BlockingIOError:
        return True
    return False


def sync(path: Path) -> None:
    """Flush a file, or the entries of a folder, to disk."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def replace(path: Path, content: str | bytes) -> None:
    """Replace a file atomically: readers, also after a crash, find the old or the new content.

    Raises:
        OSError: If writing fails; the old file is then unchanged.
    """
    part = path.with_name(f".{path.name}.part")
    with naming(path):
        part.write_bytes(content if isinstance(content, bytes) else content.encode())
        sync(part)
        part.replace(path)
        sync(path.parent)
