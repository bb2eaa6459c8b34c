# SPDX-License-Identifier: Apache-2.0
"""Is a bag whole and of bounded size? Asked of its files before anything in them is believed.

MCAP has checksums of each chunk, of everything recorded and of the summary at the end. They are
checked wherever a recorder wrote them; ours does (`seal`), so no bit of its bags changes unnoticed.
Compressed data are unpacked up to limits only, whatever sizes a file claims. Files that are no
regular files (a FIFO, a device) are refused, as reading them could block for ever.
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
HEADER, CHUNK, CHUNK_INDEX, METADATA, DATA_END, FOOTER = 0x01, 0x06, 0x08, 0x0C, 0x0F, 0x02
RECORD_HEADER = struct.Struct("<BQ")  # opcode and size
CHUNK_HEADER = struct.Struct("<QQQI")  # first and last stamp, unpacked size, checksum
CHUNK_CRC_AT = 24  # of the checksum in the body of a chunk
DATA_END_SIZE = RECORD_HEADER.size + 4
FOOTER_SIZE = RECORD_HEADER.size + 20
# The largest chunk or message; rosbag2 writes chunks of 0.8 MB, other recorders of some MB.
UNPACKED_MAX = 64_000_000  # [byte]
# A bag may unpack to this many times its size, and UNPACKED_MAX: joint states pack to a third.
RATIO_MAX = 50
TOTAL_MAX = 4_000_000_000  # of everything in a bag, unpacked: six hours of ours [byte]
RECORD_MAX = 1_000_000  # of what is read whole: metadata, or the index of one chunk [byte]
STEP = 1 << 20  # read at once [byte]


class Budget:
    """Bytes to which a bag may unpack, by its size on the disk; spent by reading it.

    Args:
        path: Folder of the bag, for messages.
        packed: Size of its files [byte].
    """

    def __init__(self, path: Path, packed: int) -> None:
        self._path, self._packed = path, packed
        self.most = self._left = min(TOTAL_MAX, UNPACKED_MAX + RATIO_MAX * packed)

    def take(self, size: int) -> None:
        """Spend some bytes.

        Raises:
            ValueError: There are not as many left.
        """
        self._left -= size
        if self._left < 0:
            raise ValueError(
                f"{self._path} has {self._packed} bytes and unpacks to more than {self.most}, the "
                f"most allowed ({RATIO_MAX} times its size and {UNPACKED_MAX}, at most {TOTAL_MAX})"
            )


def unpack(data: bytes, compression: str, size_max: int, where: str) -> bytes:
    """Decompress data, with memory for what is allowed only.

    Args:
        data: Compressed data.
        compression: "lz4", "zstd", or "" for none.
        size_max: Largest size allowed [byte].
        where: Origin for messages.

    Raises:
        ValueError: They are larger, damaged, or compressed in another way.
    """
    openers: dict[str, Callable[[BytesIO], Any]] = {
        "": lambda packed: packed,
        "lz4": lz4.frame.open,
        "zstd": zstd.open,
    }
    if compression not in openers:
        known = ", ".join(filter(None, openers))
        raise ValueError(f"{where} is compressed with {compression!r}; known are {known}")
    try:
        with openers[compression](BytesIO(data)) as packed:
            raw: bytes = packed.read(size_max + 1)
    except (zstd.ZstdError, RuntimeError, EOFError) as error:
        raise ValueError(f"{where} cannot be unpacked: {error}") from None
    if len(raw) > size_max:
        raise ValueError(f"{where} unpacks to more than {size_max} bytes, the size it declares")
    return raw


def seal(file: Path) -> None:
    """Write the checksums of everything recorded and of the summary into a closed MCAP file.

    Raises:
        OSError: When the disk refuses.
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
    """Folder in which a bag can be read, and the bytes it may yet unpack to, message by message.

    The folder is the bag's own, or a temporary one where its files are compressed as a whole.

    Raises:
        ValueError: A file is damaged, missing, no regular file, or too large unpacked.
    """
    metadata = plain_yaml.read(path / "metadata.yaml")
    information = metadata.get("rosbag2_bagfile_information") if isinstance(metadata, dict) else 0
    names = information.get("relative_file_paths") if isinstance(information, dict) else 0
    if not isinstance(names, list) or not names:
        raise ValueError(f"{path}/metadata.yaml names no file of the bag")
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
            while piece := packed.read(STEP):
                budget.take(len(piece))
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

    SQLite has no checksums: a changed value within a message is not noticed.
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
        raise ValueError(f"{file} is no sound database: {error}") from None
    if found:
        raise ValueError(f"{file} has {found[0][0]!r}, a view, a trigger or computed; no bag needs")
    if verdict != "ok":
        raise ValueError(f"{file} is damaged: {verdict}")


def _check_mcap(file: Path, information: Mapping[str, Any]) -> None:
    """Check the checksums of a file, that its index is of its chunks, and that these are small."""
    size = file.stat().st_size
    chunks: set[tuple[int, int, str, int, int]] = set()  # where, lengths and compression
    index: set[tuple[int, int, str, int, int]] = set()
    noted, sealed, footer = b"", False, -1
    budget = Budget(file, size)
    with file.open("rb") as data:
        if data.read(len(MAGIC)) != MAGIC:
            raise ValueError(f"{file} is not an MCAP file")
        for at, opcode, length in _records(data, file, size):
            if opcode in (METADATA, CHUNK_INDEX, DATA_END, FOOTER) and length > RECORD_MAX:
                raise ValueError(f"{file}: record at byte {at} has {length} bytes")
            if opcode == CHUNK:
                chunks.add(_check_chunk(data, at, length, budget, file))
            elif opcode == METADATA:
                noted = data.read(length)
            elif opcode == DATA_END:
                (crc,) = struct.unpack("<I", data.read(4))
                sealed = bool(crc)
                if crc and crc != _crc(data, 0, at):
                    raise ValueError(f"{file} is damaged: its checksum is not that of its contents")
            elif opcode == CHUNK_INDEX:
                index.add(_indexed(data.read(length)))
            elif opcode == FOOTER:
                footer = at
                summary, _, crc = struct.unpack("<QQI", data.read(20))
                if crc and crc != _crc(data, summary, at + FOOTER_SIZE - 4):
                    raise ValueError(f"{file} is damaged: the checksum of its summary is wrong")
        data.seek(size - len(MAGIC))
        if data.read() != MAGIC or footer != size - len(MAGIC) - FOOTER_SIZE:
            raise ValueError(f"{file} does not end as an MCAP file: it is cut or damaged")
    if index and index != chunks:
        raise ValueError(f"{file} is damaged: its index is not of its chunks")
    if sealed:
        _check_notes(file, noted, information)


def _records(data: BinaryIO, file: Path, size: int) -> Iterator[tuple[int, int, int]]:
    """Offset, opcode and length of every record of a file, which is then at its body."""
    at, end = len(MAGIC), size - len(MAGIC)
    while at < end:
        data.seek(at)
        head = data.read(RECORD_HEADER.size)
        opcode, length = RECORD_HEADER.unpack(head) if len(head) == RECORD_HEADER.size else (0, end)
        if at + RECORD_HEADER.size + length > end:
            raise ValueError(f"{file}: record at byte {at} ends beyond the file: cut or damaged")
        yield at, opcode, length
        at += RECORD_HEADER.size + length


def _check_chunk(
    data: BinaryIO, at: int, length: int, budget: Budget, file: Path
) -> tuple[int, int, str, int, int]:
    where = f"{file}: chunk at byte {at}"
    head = data.read(CHUNK_HEADER.size + 4)
    _, _, size, crc, named = struct.unpack("<QQQII", head)
    if named > 16:
        raise ValueError(f"{where} is damaged: {named} bytes name its compression")
    compression = data.read(named).decode()
    (packed,) = struct.unpack("<Q", data.read(8))
    if length != CHUNK_HEADER.size + 4 + named + 8 + packed:
        raise ValueError(f"{where} is damaged: {packed} bytes do not fit in {length}")
    if max(size, packed) > UNPACKED_MAX:
        raise ValueError(f"{where} unpacks to {size} bytes; at most {UNPACKED_MAX} are allowed")
    budget.take(size)
    raw = unpack(data.read(packed), compression, size, where)
    if len(raw) != size:
        raise ValueError(f"{where} unpacks to {len(raw)} bytes, not {size}")
    if crc and crc != zlib.crc32(raw):
        raise ValueError(f"{where} is damaged: its checksum is not that of its contents")
    return at, RECORD_HEADER.size + length, compression, packed, size


def _indexed(record: bytes) -> tuple[int, int, str, int, int]:
    """What the index says of a chunk, as `_check_chunk` returns it."""
    at, length = struct.unpack_from("<QQ", record, 16)
    (offsets,) = struct.unpack_from("<I", record, 32)
    (named,) = struct.unpack_from("<I", record, 36 + offsets + 8)
    begin = 36 + offsets + 12
    packed, size = struct.unpack_from("<QQ", record, begin + named)
    return at, length, record[begin : begin + named].decode(), packed, size


def _check_notes(file: Path, noted: bytes, information: Mapping[str, Any]) -> None:
    """Refuse a metadata.yaml that is not what the checked file says it was."""
    at, texts = 0, []
    while at + 4 <= len(noted):  # name, size of the map, key, value: of ours each once
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
            f"{file.parent / 'metadata.yaml'} is not as the recorder wrote it: "
            f"{', '.join(map(str, differ))} differ from the copy in {file.name}"
        )


def _crc(data: BinaryIO, begin: int, end: int) -> int:
    """CRC-32 of the bytes from `begin` to before `end`."""
    data.seek(begin)
    crc = 0
    while begin < end and (piece := data.read(min(STEP, end - begin))):
        crc = zlib.crc32(piece, crc)
        begin += len(piece)
    return crc
