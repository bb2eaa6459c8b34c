# SPDX-License-Identifier: Apache-2.0
"""Files that survive a crash: flushed to the disk, and replaced as a whole."""

from __future__ import annotations

import os
from pathlib import Path


def sync(path: Path) -> None:
    """Flush a file, or the entries of a folder, to the disk."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def replace(path: Path, text: str) -> None:
    """Write a file so that readers, and a crash, leave the old or the new text, never a part.

    Raises:
        OSError: When the disk refuses; the old file is then still there.
    """
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8")
    sync(part)
    part.replace(path)
    sync(path.parent)
