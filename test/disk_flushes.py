# SPDX-License-Identifier: Apache-2.0
"""What is flushed to the disk, in which order, and what a file holds at that moment: for tests."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest


def record_flushes(
    monkeypatch: pytest.MonkeyPatch, look: Callable[[], object]
) -> list[tuple[Path, object]]:
    """Files and folders in the order they are flushed from now on, each with what `look` sees then.

    A file is flushed by its descriptor: which one it was is what /proc says.
    """
    flushed: list[tuple[Path, object]] = []
    fsync = os.fsync

    def recorded(file: int) -> None:
        flushed.append((Path(os.readlink(f"/proc/self/fd/{file}")), look()))
        fsync(file)

    monkeypatch.setattr(os, "fsync", recorded)
    return flushed
