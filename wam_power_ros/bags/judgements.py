# SPDX-License-Identifier: Apache-2.0
"""Judgements of takes, kept in their folders, so that a list does not judge each take anew.

A judgement is used only while every byte of the bag, the code that judged it and the set-up are the
same. It serves lists alone: whatever uses a take reads and judges it itself.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from wam_power_ros import durable_files, plain_json

FILE = ".judgement.json"  # in the folder of a bag
SIZE_MAX = 20_000  # [byte] of that file
READ_SIZE = 1 << 20  # [byte]


class Judgements:
    """Judgements by the same code and set-up.

    Args:
        code: Folders whose Python files judge.
        about: Texts on which a judgement depends, such as the set-up.
    """

    def __init__(self, code: Iterable[Path], about: Sequence[str]) -> None:
        files = [file for folder in code for file in folder.rglob("*.py")]
        self._by = json.dumps([*about, *_digests(files)])

    def of(self, bag: Path, judge: Callable[[], tuple[str, ...]]) -> tuple[str, ...]:
        """Texts of a judgement: those kept with the bag, else those of `judge`, which are kept.

        Args:
            bag: Folder of the bag.
            judge: Judges it; what it raises is not kept.
        """
        digest = self._digest(bag)
        if digest and (kept := _read(bag / FILE, digest)):
            return kept
        texts = judge()
        if digest and digest == self._digest(bag):  # the bag did not change meanwhile
            with suppress(OSError):  # in a folder that cannot be written, it is judged each time
                (bag / FILE).write_text(json.dumps({"of": digest, "texts": texts}))
        return texts

    def _digest(self, bag: Path) -> str:
        """Digest of the files of a bag and of what judges it; empty if they cannot be read."""
        try:
            found = _digests(file for file in bag.iterdir() if file.name != FILE)
        except (OSError, ValueError):
            return ""
        return hashlib.sha256(json.dumps([self._by, *found]).encode()).hexdigest()


def _digests(files: Iterable[Path]) -> list[str]:
    """Name and SHA-256 of each file.

    Raises:
        ValueError: One is not a regular file.
        OSError: One cannot be read.
    """
    found = []
    for file in sorted(files):
        durable_files.check_regular(file)
        digest = hashlib.sha256()
        with file.open("rb") as opened:
            while piece := opened.read(READ_SIZE):
                digest.update(piece)
        found += [file.name, digest.hexdigest()]
    return found


def _read(file: Path, digest: str) -> tuple[str, ...]:
    """Texts that were kept under a digest, if they are printable; else none."""
    with suppress(ValueError, OSError):
        kept = plain_json.read(file, SIZE_MAX)
        texts = kept["texts"] if isinstance(kept, dict) and kept.get("of") == digest else []
        if isinstance(texts, list) and all(isinstance(t, str) and t.isprintable() for t in texts):
            return tuple(texts)
    return ()
