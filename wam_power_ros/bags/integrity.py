# SPDX-License-Identifier: Apache-2.0
"""Checks that a bag is undamaged and of bounded size, before its contents are used.

MCAP has checksums of each chunk, of the data section and of the summary. They are verified if the
recorder wrote them; ours does, so any changed bit of its bags is detected. Compressed data are
unpacked up to fixed limits, whatever sizes a file declares. Files other than regular ones (a FIFO,
a device) are refused, as reading them could block for ever.
"""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Callable, Mapping
from contextlib import closing
from io import BytesIO
from mmap import mmap
from pathlib import Path, PurePath
from typing import Any

import lz4.frame
from backports import zstd
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex, DataEnd, Footer, Metadata

from wam_power_ros import plain_yaml
from wam_power_ros.bags import mcap_records
from wam_power_ros.bags.mcap_records import MAGIC
from wam_power_ros.durable_files import check_regular

# The largest chunk or message; rosbag2 writes chunks of 0.8 MB, other recorders of a few MB.
UNPACKED_MAX = 64_000_000  # [byte]
# A bag may unpack to this many times its size plus UNPACKED_MAX: joint states pack to a third.
RATIO_MAX = 50
TOTAL_MAX = 4_000_000_000  # unpacked size of a bag: six hours of our recorder [byte]
# Largest records that are read as a whole [byte]
RECORD_MAX: dict[int, int] = {
    Opcode.CHUNK: UNPACKED_MAX + 1000,
    Opcode.METADATA: 1_000_000,
    Opcode.CHUNK_INDEX: 1_000_000,
    Opcode.DATA_END: 4,
    Opcode.FOOTER: 20,
}
READ_SIZE = 1 << 20  # [byte]
PACKED = ".zstd"  # suffix of a file that is compressed as a whole
ZSTD = b"\x28\xb5\x2f\xfd"  # begins compressed data; a message begins with a zero
WAL = "-wal"  # suffix of the messages beside a database that was not closed


class Budget:
    """Number of bytes to which a bag may unpack, by its size on the disk.

    Args:
        path: Folder of the bag, for messages.
        packed: Size of its files [byte].
    """

    def __init__(self, path: Path, packed: int) -> None:
        self._path, self._packed = path, packed
        self._limit = self._left = min(TOTAL_MAX, UNPACKED_MAX + RATIO_MAX * packed)

    def spend(self, size: int) -> None:
        """Spend a number of bytes.

        Raises:
            ValueError: The budget is exhausted.
        """
        self._left -= size
        if self._left < 0:
            raise ValueError(
                f"{self._path} has {self._packed} bytes and unpacks to more than {self._limit}, "
                f"the limit ({RATIO_MAX} times its size plus {UNPACKED_MAX}, at most {TOTAL_MAX})"
            )


def unpack(data: bytes, compression: str, size_max: int, where: str) -> bytes:
    """Decompress data without using more memory than allowed.

    Args:
        data: Compressed data.
        compression: "lz4", "zstd", or "" for none.
        size_max: Largest unpacked size allowed [byte].
        where: Origin of the data for messages.

    Raises:
        ValueError: The data are larger, damaged, or of an unknown compression.
    """
    openers: dict[str, Callable[[BytesIO], Any]] = {
        "": lambda packed: packed,
        "lz4": lz4.frame.open,
        "zstd": zstd.open,
    }
    if compression not in openers:
        known = ", ".join(filter(None, openers))
        raise ValueError(f"{where} is compressed with {compression!r}, which is not one of {known}")
    try:
        with openers[compression](BytesIO(data)) as packed:
            raw: bytes = packed.read(size_max + 1)
    except (zstd.ZstdError, RuntimeError, EOFError) as error:
        raise ValueError(f"{where} cannot be unpacked: {error}") from None
    if len(raw) > size_max:
        raise ValueError(f"{where} unpacks to more than {size_max} bytes, the size it declares")
    return raw


def information(metadata: object) -> Mapping[str, Any]:
    """Description of a bag in the contents of its metadata.yaml.

    Raises:
        ValueError: It does not name the files of the bag.
    """
    found = metadata.get("rosbag2_bagfile_information") if isinstance(metadata, dict) else None
    if not isinstance(found, dict) or not isinstance(found.get("relative_file_paths"), list):
        raise ValueError("metadata.yaml has no relative_file_paths")
    return found


def verified(path: Path, information: Mapping[str, Any], folder: Callable[[], Path]) -> list[Path]:
    """Files of a bag, each of which was verified once.

    Args:
        path: Folder of the bag.
        information: Its description, see `information`.
        folder: Returns a folder for the files of a bag whose files are compressed as a whole.

    Raises:
        ValueError: A file is damaged, missing, not a regular file, or too large when unpacked.
    """
    within = path.parent if path.is_file() else path
    files = [within / PurePath(str(name)).name for name in information["relative_file_paths"]]
    for file in files:
        check_regular(file)
    if str(information.get("compression_mode")).lower() == "file":
        budget, to = Budget(path, sum(file.stat().st_size for file in files)), folder()
        files = [_unpack_file(file, to / file.stem, budget) for file in files]
    for file in files:
        verify(file, {} if path.is_file() else information)
    return files


def unpacked(file: Path, folder: Callable[[], Path]) -> Path:
    """A lone file, unpacked if it is compressed as a whole; see `verified`."""
    if file.suffix != PACKED:
        return file
    check_regular(file)
    return _unpack_file(file, folder() / file.stem, Budget(file, file.stat().st_size))


def _unpack_file(file: Path, to: Path, budget: Budget) -> Path:
    try:
        with zstd.open(file, "rb") as packed, to.open("xb") as out:
            while piece := packed.read(READ_SIZE):
                budget.spend(len(piece))
                out.write(piece)
    except (zstd.ZstdError, EOFError) as error:
        raise ValueError(f"{file} cannot be unpacked: {error}") from None
    return to


def verify(file: Path, information: Mapping[str, Any]) -> None:
    """Check one file of a bag.

    Raises:
        ValueError: It is damaged, too large when unpacked, neither MCAP nor SQLite, or differs
            from `information`, the description of the bag; empty for a file without.
    """
    if file.suffix == ".mcap":
        with mcap_records.mapped(file) as data:
            _check_mcap(file, data, information)
    elif file.suffix == ".db3":
        _check_sqlite(file)
    else:
        raise ValueError(f"{file.name} is not an .mcap or .db3 file")


def _check_sqlite(file: Path) -> None:
    """Refuse a damaged database, one whose rows are computed instead of stored, and one not closed.

    SQLite has no checksums: a changed value within a message is not detected. A recorder that was
    killed may leave its last messages in a file beside the database, which is not read.
    """
    wal = file.with_name(file.name + WAL)
    if wal.exists() and wal.stat().st_size:
        raise ValueError(
            f"{file} was not closed: {wal.name} holds messages that are not in it yet; "
            f"sqlite3 {file} 'PRAGMA wal_checkpoint(TRUNCATE)' moves them there"
        )
    computed = (
        "SELECT name FROM sqlite_master WHERE type IN ('view', 'trigger') "
        "OR type = 'table' AND rootpage = 0 "
        "UNION SELECT item.name FROM sqlite_master AS item, pragma_table_xinfo(item.name) AS entry "
        "WHERE item.type = 'table' AND entry.hidden"
    )
    try:
        address = f"{file.absolute().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(address, uri=True)) as database:
            found = database.execute(computed).fetchall()
            (verdict,) = database.execute("PRAGMA quick_check(1)").fetchone()
    except sqlite3.Error as error:
        raise ValueError(f"{file} is not a valid database: {error}") from None
    if found:
        raise ValueError(f"{file} has a view, trigger or computed table {found[0][0]!r}: refused")
    if verdict != "ok":
        raise ValueError(f"{file} is damaged: {verdict}")


def _check_mcap(file: Path, data: mmap, information: Mapping[str, Any]) -> None:
    """Check the checksums of a file, the index of its chunks, and their unpacked size."""
    size = len(data) - len(MAGIC)  # at the end as well
    budget = Budget(file, size)
    chunks, index = set(), set()
    noted = b""
    sealed: bool | None = None  # None until the end of the data
    opcode, end = 0, len(MAGIC)
    for opcode, at, begin, end in mcap_records.records(data, len(MAGIC)):
        if end > size:
            break
        if end - begin > RECORD_MAX.get(opcode, size):
            raise ValueError(
                f"{file}: record at byte {at} has {end - begin} bytes, limit {RECORD_MAX[opcode]}"
            )
        body = data[begin:end] if opcode in RECORD_MAX else b""
        if opcode == Opcode.CHUNK:
            chunk = mcap_records.parsed(Chunk, body)
            _check_chunk(chunk, f"{file}: chunk at byte {at}", budget)
            chunks.add((at, end - at, chunk.compression, len(chunk.data), chunk.uncompressed_size))
        elif opcode == Opcode.METADATA:
            noted = body
        elif opcode == Opcode.DATA_END:
            crc = mcap_records.parsed(DataEnd, body).data_section_crc
            sealed = bool(crc)
            if crc and crc != _crc(data, 0, at):
                raise ValueError(f"{file} is damaged: the checksum of its data is wrong")
        elif opcode == Opcode.CHUNK_INDEX:
            item = mcap_records.parsed(ChunkIndex, body)
            place = (item.chunk_start_offset, item.chunk_length, item.compression)
            index.add((*place, item.compressed_size, item.uncompressed_size))
        elif opcode == Opcode.FOOTER:
            footer = mcap_records.parsed(Footer, body)
            crc = footer.summary_crc
            if crc and crc != _crc(data, footer.summary_start, end - 4):
                raise ValueError(f"{file} is damaged: the checksum of its summary is wrong")
            break
    if sealed is None or end != size or opcode != Opcode.FOOTER or data[size:] != MAGIC:
        raise ValueError(f"{file} does not end as an MCAP file: it is truncated or damaged")
    if index and index != chunks:
        raise ValueError(f"{file} is damaged: its index does not match its chunks")
    if sealed:
        _check_notes(file, noted, information)


def _check_chunk(chunk: Chunk, where: str, budget: Budget) -> None:
    size = chunk.uncompressed_size
    if size > UNPACKED_MAX:
        raise ValueError(f"{where} unpacks to {size} bytes; at most {UNPACKED_MAX} are allowed")
    budget.spend(size)
    raw = unpack(chunk.data, chunk.compression, size, where)
    if len(raw) != size:
        raise ValueError(f"{where} unpacks to {len(raw)} bytes, not {size}")
    if chunk.uncompressed_crc not in (0, zlib.crc32(raw)):
        raise ValueError(f"{where} is damaged: its checksum is wrong")


def _check_notes(file: Path, noted: bytes, information: Mapping[str, Any]) -> None:
    """Refuse a metadata.yaml that differs from the copy in the checked file."""
    first = _information(file, noted)
    if first and information and first != information:
        keys = first.keys() | information.keys()
        differ = sorted(key for key in keys if first.get(key) != information.get(key))
        raise ValueError(
            f"metadata.yaml was changed after the recording: "
            f"{', '.join(map(str, differ))} differ from the copy in {file.name}"
        )


def _information(file: Path, noted: bytes) -> Mapping[str, Any]:
    """Description of the bag in a metadata record of its file; empty if there is none."""
    metadata = mcap_records.parsed(Metadata, noted).metadata if noted else {}
    found = plain_yaml.parse(metadata.get("serialized_metadata", "{}").encode(), str(file))
    return found if isinstance(found, dict) else {}


def noted(file: Path) -> Mapping[str, Any]:
    """Description of the bag that rosbag2 keeps in an MCAP file; empty if there is none.

    Raises:
        ValueError: It is not an MCAP file, or damaged.
    """
    last = b""
    with mcap_records.mapped(file) as data:
        for opcode, _, begin, end in mcap_records.records(data, len(MAGIC)):
            if opcode == Opcode.METADATA and end - begin <= RECORD_MAX[opcode]:
                last = data[begin:end]
    return _information(file, last)


def _crc(data: mmap, begin: int, end: int) -> int:
    """CRC-32 of the bytes from `begin` to before `end`."""
    with memoryview(data) as view:
        return zlib.crc32(view[begin:end])
