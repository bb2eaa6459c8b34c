# SPDX-License-Identifier: Apache-2.0
"""Checks that a bag is undamaged and of bounded size, before its contents are used.

MCAP has checksums of each chunk, of the data section and of the summary. They are verified if the
recorder wrote them; ours does (`seal`), so any changed bit of its bags is detected. Compressed data
are unpacked up to fixed limits, whatever sizes a file declares. Files other than regular ones (a
FIFO, a device) are refused, as reading them could block for ever.
"""

from __future__ import annotations

import sqlite3
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from io import BytesIO
from pathlib import Path, PurePath
from typing import Any, BinaryIO

import lz4.frame
import yaml
from backports import zstd

from wam_power_ros import plain_yaml
from wam_power_ros.durable_files import check_regular

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06  # opcodes of records
CHUNK_INDEX, METADATA, DATA_END = 0x08, 0x0C, 0x0F
RECORD_HEADER = struct.Struct("<BQ")  # opcode and size
CHUNK_HEADER = struct.Struct("<QQQI")  # first and last stamp, unpacked size, checksum
CHUNK_CRC_OFFSET = 24  # of the checksum in the body of a chunk [byte]
DATA_END_SIZE = RECORD_HEADER.size + 4
FOOTER_SIZE = RECORD_HEADER.size + 20
# The largest chunk or message; rosbag2 writes chunks of 0.8 MB, other recorders of a few MB.
UNPACKED_MAX = 64_000_000  # [byte]
# A bag may unpack to this many times its size plus UNPACKED_MAX: joint states pack to a third.
RATIO_MAX = 50
TOTAL_MAX = 4_000_000_000  # unpacked size of a bag: six hours of our recorder [byte]
RECORD_MAX = 1_000_000  # of a record that is read as a whole: metadata, index of a chunk [byte]
READ_SIZE = 1 << 20  # [byte]


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


def seal(file: Path) -> None:
    """Write the checksums of the data section and of the summary into a closed MCAP file.

    Raises:
        OSError: The file cannot be written.
    """
    with file.open("r+b") as data:
        footer = data.seek(-FOOTER_SIZE - len(MAGIC), 2)
        data.seek(footer + RECORD_HEADER.size)
        (summary,) = struct.unpack("<Q", data.read(8))
        data_end = summary - DATA_END_SIZE
        crc = _crc(data, 0, data_end)
        data.seek(data_end + RECORD_HEADER.size)
        data.write(struct.pack("<I", crc))
        crc = _crc(data, summary, footer + FOOTER_SIZE - 4)
        data.seek(footer + FOOTER_SIZE - 4)
        data.write(struct.pack("<I", crc))


@contextmanager
def checked(path: Path) -> Iterator[tuple[Path, Budget]]:
    """Check a bag; yields the folder to read it from, and the budget for its messages.

    The folder is the bag itself, or a temporary one if its files are compressed as a whole.

    Raises:
        ValueError: A file is damaged, missing, not a regular file, or too large when unpacked.
    """
    metadata = plain_yaml.read(path / "metadata.yaml")
    information = metadata.get("rosbag2_bagfile_information") if isinstance(metadata, dict) else 0
    names = information.get("relative_file_paths") if isinstance(information, dict) else 0
    if not isinstance(names, list) or not names:
        raise ValueError(f"{path}/metadata.yaml has no relative_file_paths")
    files = [path / PurePath(str(name)).name for name in names]
    for file in files:
        check_regular(file)
    budget = Budget(path, sum(file.stat().st_size for file in files))
    if str(information.get("compression_mode", "")).lower() != "file":
        _check_files(files, information)
        yield path, budget
        return
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        unpacked = [_unpack_file(file, folder / file.stem, budget) for file in files]
        information |= {
            "relative_file_paths": [file.name for file in unpacked],
            "compression_mode": "",
            "compression_format": "",
        }
        text = yaml.safe_dump({"rosbag2_bagfile_information": information})
        (folder / "metadata.yaml").write_text(text)
        _check_files(unpacked, information)
        yield folder, budget


def _unpack_file(file: Path, to: Path, budget: Budget) -> Path:
    try:
        with zstd.open(file, "rb") as packed, to.open("xb") as out:
            while piece := packed.read(READ_SIZE):
                budget.spend(len(piece))
                out.write(piece)
    except (zstd.ZstdError, EOFError) as error:
        raise ValueError(f"{file} cannot be unpacked: {error}") from None
    return to


def _check_files(files: list[Path], information: Mapping[str, Any]) -> None:
    check = {"mcap": _check_mcap, "sqlite3": _check_sqlite}.get(information["storage_identifier"])
    if check is None:
        raise ValueError(f"storage {information['storage_identifier']!r} is not mcap or sqlite3")
    for file in files:
        check(file, information)


def _check_sqlite(file: Path, _: Mapping[str, Any]) -> None:
    """Refuse a damaged database, and one whose rows are computed instead of stored.

    SQLite has no checksums: a changed value within a message is not detected.
    """
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


def _check_mcap(file: Path, information: Mapping[str, Any]) -> None:
    """Check the checksums of a file, the index of its chunks, and their unpacked size."""
    size = file.stat().st_size
    chunks: set[tuple[int, int, str, int, int]] = set()  # see `_check_chunk`
    index: set[tuple[int, int, str, int, int]] = set()
    noted, footer = b"", -1
    sealed: bool | None = None  # None until the end of the data
    budget = Budget(file, size)
    with file.open("rb") as data:
        if data.read(len(MAGIC)) != MAGIC:
            raise ValueError(f"{file} is not an MCAP file")
        for at, opcode, length in _records(data, file, size):
            if opcode in (METADATA, CHUNK_INDEX, DATA_END, FOOTER) and length > RECORD_MAX:
                raise ValueError(
                    f"{file}: record at byte {at} has {length} bytes, limit {RECORD_MAX}"
                )
            if opcode == CHUNK:
                chunks.add(_check_chunk(data, at, length, budget, file))
            elif opcode == METADATA:
                noted = data.read(length)
            elif opcode == DATA_END:
                (crc,) = struct.unpack("<I", data.read(4))
                sealed = bool(crc)
                if crc and crc != _crc(data, 0, at):
                    raise ValueError(f"{file} is damaged: the checksum of its data is wrong")
            elif opcode == CHUNK_INDEX:
                index.add(_indexed_chunk(data.read(length)))
            elif opcode == FOOTER:
                footer = at
                summary, _, crc = struct.unpack("<QQI", data.read(20))
                if crc and crc != _crc(data, summary, at + FOOTER_SIZE - 4):
                    raise ValueError(f"{file} is damaged: the checksum of its summary is wrong")
        data.seek(size - len(MAGIC))
        if sealed is None:
            raise ValueError(f"{file} is damaged: it has no end of its data")
        if data.read() != MAGIC or footer != size - len(MAGIC) - FOOTER_SIZE:
            raise ValueError(f"{file} does not end as an MCAP file: it is truncated or damaged")
    if index and index != chunks:
        raise ValueError(f"{file} is damaged: its index does not match its chunks")
    if sealed:
        _check_notes(file, noted, information)


def _records(data: BinaryIO, file: Path, size: int) -> Iterator[tuple[int, int, int]]:
    """Offset, opcode and length of every record; the file is positioned at its body."""
    at, end = len(MAGIC), size - len(MAGIC)
    while at < end:
        data.seek(at)
        head = data.read(RECORD_HEADER.size)
        opcode, length = RECORD_HEADER.unpack(head) if len(head) == RECORD_HEADER.size else (0, end)
        if at + RECORD_HEADER.size + length > end:
            raise ValueError(
                f"{file}: record at byte {at} ends beyond the file, which is truncated or damaged"
            )
        yield at, opcode, length
        at += RECORD_HEADER.size + length


def _check_chunk(
    data: BinaryIO, at: int, length: int, budget: Budget, file: Path
) -> tuple[int, int, str, int, int]:
    """Check a chunk; returns its offset, length, compression, packed and unpacked size [byte]."""
    where = f"{file}: chunk at byte {at}"
    head = data.read(CHUNK_HEADER.size + 4)
    _, _, size, crc, name_size = struct.unpack("<QQQII", head)
    if name_size > 16:
        raise ValueError(f"{where} is damaged: its compression has a name of {name_size} bytes")
    compression = data.read(name_size).decode()
    (packed,) = struct.unpack("<Q", data.read(8))
    if length != CHUNK_HEADER.size + 4 + name_size + 8 + packed:
        raise ValueError(f"{where} is damaged: {packed} bytes do not fit in {length}")
    if max(size, packed) > UNPACKED_MAX:
        raise ValueError(f"{where} unpacks to {size} bytes; at most {UNPACKED_MAX} are allowed")
    budget.spend(size)
    raw = unpack(data.read(packed), compression, size, where)
    if len(raw) != size:
        raise ValueError(f"{where} unpacks to {len(raw)} bytes, not {size}")
    if crc and crc != zlib.crc32(raw):
        raise ValueError(f"{where} is damaged: its checksum is wrong")
    return at, RECORD_HEADER.size + length, compression, packed, size


def _indexed_chunk(record: bytes) -> tuple[int, int, str, int, int]:
    """Description of a chunk in the index, as `_check_chunk` returns it."""
    at, length = struct.unpack_from("<QQ", record, 16)
    (offsets,) = struct.unpack_from("<I", record, 32)
    (name_size,) = struct.unpack_from("<I", record, 36 + offsets + 8)
    begin = 36 + offsets + 12
    packed, size = struct.unpack_from("<QQ", record, begin + name_size)
    return at, length, record[begin : begin + name_size].decode(), packed, size


def _check_notes(file: Path, noted: bytes, information: Mapping[str, Any]) -> None:
    """Refuse a metadata.yaml that differs from the copy in the checked file."""
    at, texts = 0, []
    while at + 4 <= len(noted):  # name, size of the map, key, value; our recorder writes one each
        (size,) = struct.unpack_from("<I", noted, at)
        texts.append(noted[at + 4 : at + 4 + size])
        at += 4 + (0 if len(texts) == 2 else size)
    if len(texts) != 4 or texts[0] != b"rosbag2":
        return
    first = plain_yaml.parse(texts[3], str(file))
    if isinstance(first, dict) and first != information:
        keys = first.keys() | information.keys()
        differ = sorted(key for key in keys if first.get(key) != information.get(key))
        raise ValueError(
            f"{file.parent / 'metadata.yaml'} was changed after the recording: "
            f"{', '.join(map(str, differ))} differ from the copy in {file.name}"
        )


def _crc(data: BinaryIO, begin: int, end: int) -> int:
    """CRC-32 of the bytes from `begin` to before `end`."""
    data.seek(begin)
    crc = 0
    while begin < end and (piece := data.read(min(READ_SIZE, end - begin))):
        crc = zlib.crc32(piece, crc)
        begin += len(piece)
    return crc
