# SPDX-License-Identifier: Apache-2.0
"""Records of MCAP files, also of truncated ones: https://mcap.dev/spec."""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import McapRecord

from wam_power_ros.durable_files import check_regular

MAGIC = b"\x89MCAP0\r\n"
HEADER = struct.Struct("<BQ")  # opcode and size of a record

R = TypeVar("R", bound=McapRecord)


@contextmanager
def mapped(file: Path) -> Iterator[mmap.mmap]:
    """Contents of an MCAP file.

    Raises:
        ValueError: It is not a regular file, empty, or not an MCAP file.
    """
    check_regular(file)
    with file.open("rb") as opened, mmap.mmap(opened.fileno(), 0, prot=mmap.PROT_READ) as data:
        if data[: len(MAGIC)] != MAGIC:
            raise ValueError(f"{file} is not an MCAP file: it begins {data[:8]!r}")
        yield data


def records(data: bytes | mmap.mmap, at: int) -> Iterator[tuple[int, int, int, int]]:
    """Opcode of every record from an offset on, its own offset, and begin and end of its body.

    The body of the last record may end beyond the data.
    """
    while at + HEADER.size <= len(data):
        opcode, size = HEADER.unpack_from(data, at)
        begin, end = at + HEADER.size, at + HEADER.size + size
        yield opcode, at, begin, end
        at = end


def parsed(kind: type[R], body: bytes) -> R:
    """Record of a kind; of a truncated body, its last field may be truncated.

    Raises:
        ValueError: The body is damaged.
    """
    try:
        record: R = kind.read(ReadDataStream(BytesIO(body)))  # type: ignore[attr-defined]
    except (McapError, struct.error, OverflowError) as error:
        raise ValueError(f"{kind.__name__} of {len(body)} bytes is damaged: {error}") from None
    return record
