# SPDX-License-Identifier: Apache-2.0
"""Files that survive a crash: flushed to disk and replaced atomically."""

from __future__ import annotations

import os
import stat
from pathlib import Path

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def check_regular(path: Path) -> None:
    """Check that a path is a regular file: reading a FIFO or a device may block or never end.

    Raises:
        ValueError: If it is another kind of file, missing or a broken link; the message says which.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, RuntimeError) as error:  # RuntimeError: a loop of links, before Python 3.13
        raise ValueError(f"{path}: {getattr(error, 'strerror', error)}") from None
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "a special file")
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


def sync(path: Path) -> None:
    """Flush a file, or the entries of a folder, to disk."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def replace(path: Path, text: str) -> None:
    """Replace a file atomically: readers, also after a crash, find the old or the new text.

    Raises:
        OSError: If writing fails; the old file is then unchanged.
    """
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8")
    sync(part)
    part.replace(path)
    sync(path.parent)
