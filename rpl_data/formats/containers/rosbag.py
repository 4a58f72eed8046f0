"""Repair a ROS bag (version 2.0) that its recorder never closed, or that was cut off.

A bag is a list of records: its header, then chunks of messages, each followed by its index. The topics and
the positions of the chunks are written at the end, on closing; without them no player opens the file.
All of this can be recovered from the chunks that are complete, as `rosbag reindex` does.
Format: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, BinaryIO

from rpl_data.files import decoding, refuse_special, writing
from rpl_data.formats.containers.lz4 import unpack_lz4
from rpl_data.types import DataError

_START = b"#ROSBAG V2.0\n"
_BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 3, 4, 5, 6, 7

Fields = Mapping[str, bytes]


@dataclass(frozen=True)
class BagRepair:
    """Result of a repair.

    Attributes:
        messages: number of messages in the complete chunks.
        seconds: time from the first of them to the last.
        lost_bytes: bytes after the last complete chunk.
    """

    messages: int
    seconds: float
    lost_bytes: int


@dataclass
class _Chunk:
    """A chunk with its index.

    Attributes:
        at: offset of its record in the file.
        end: offset after its index.
        data_at: offset of its packed records.
        data_bytes: their size.
        compression: none, lz4 or bz2.
        counts: number of messages per connection.
        times: time of the first and the last message, in seconds and nanoseconds.
    """

    at: int
    end: int
    data_at: int
    data_bytes: int
    compression: str
    counts: dict[int, int] = field(default_factory=dict)
    times: list[tuple[int, int]] = field(default_factory=list)


def repair_bag(path: Path, repaired: Path) -> BagRepair:
    """Write `repaired`: the complete chunks of a bag, with everything that a closed bag has.

    Raises:
        DataError: the file is not a bag, or has no complete chunk.
    """
    refuse_special(path)
    with decoding(path, "record it again"):
        return _repaired(path, repaired)


def _repaired(path: Path, repaired: Path) -> BagRepair:
    with path.open("rb") as file:
        size = file.seek(0, 2)
        chunks, connections = _scan(file, path)
        with writing(repaired, "wb") as out:
            _write(out, file, chunks, connections)
    times = [time for chunk in chunks for time in chunk.times]
    (first_s, first_ns), (last_s, last_ns) = min(times), max(times)
    seconds = last_s - first_s + (last_ns - first_ns) * 1e-9
    return BagRepair(sum(sum(chunk.counts.values()) for chunk in chunks), seconds, size - chunks[-1].end)


def _scan(file: BinaryIO, path: Path) -> tuple[list[_Chunk], dict[int, bytes]]:
    """Find the complete chunks in order, and the records of the connections they use."""
    file.seek(0)
    if file.read(len(_START)) != _START:
        raise DataError(f"{path} is not a ROS bag of version 2.0; expected a recording of a RealSense camera")
    file.seek(_after_header(file))
    chunks: list[_Chunk] = []
    connections: dict[int, bytes] = {}
    while (chunk := _next_chunk(file)) is not None:
        if set(chunk.counts) - set(connections):
            connections |= _connections(_content(file, path, chunk))
            file.seek(chunk.end)
        chunks.append(chunk)
    if not any(chunk.times for chunk in chunks):
        raise DataError(f"{path} was cut off within its first chunk; nothing of it can be kept")
    return chunks, connections


def _after_header(file: BinaryIO) -> int:
    """Where the record of the bag's header ends; it is padded, so that it can be rewritten in place.

    ROS and librealsense pad it to 4104 bytes, the package `rosbags` to 4096.
    """
    file.seek(len(_START))
    record = _record(file)
    return file.tell() + (0 if record is None else record[1])


def _next_chunk(file: BinaryIO) -> _Chunk | None:
    """Read the chunk that starts here with its complete index; None when there is none."""
    at = file.tell()
    record = _record(file)
    if record is None or record[0].get("op") != bytes([_CHUNK]):
        return None
    compression = record[0].get("compression", b"none").decode("ascii", "replace")
    chunk = _Chunk(at, at, file.tell(), record[1], compression)
    file.seek(chunk.data_bytes, 1)
    while True:
        end = file.tell()
        record = _record(file)
        if record is None or record[0].get("op") != bytes([_INDEX]):
            chunk.end = end
            file.seek(end)
            return chunk if chunk.counts and _reaches(file, end) else None
        _add_index(chunk, record[0], file.read(record[1]))


def _reaches(file: BinaryIO, offset: int) -> bool:
    size = file.seek(0, 2)
    file.seek(offset)
    return size >= offset


def _add_index(chunk: _Chunk, fields: Fields, data: bytes) -> None:
    """Count the messages of an index record (version 1), which has the time and offset of each."""
    entries = list(struct.iter_unpack("<III", data[: len(data) // 12 * 12]))
    connection = int.from_bytes(fields["conn"], "little")
    chunk.counts[connection] = chunk.counts.get(connection, 0) + len(entries)
    chunk.times += [min(entries)[:2], max(entries)[:2]] if entries else []


def _record(file: BinaryIO) -> tuple[Fields, int] | None:
    """Read the header of the record that starts here, and the size of its data; None when cut off."""
    length = file.read(4)
    header = file.read(int.from_bytes(length, "little"))
    size = file.read(4)
    if len(size) < 4:
        return None
    return _fields(header), int.from_bytes(size, "little")


def _fields(header: bytes) -> Fields:
    fields, at = {}, 0
    while at + 4 <= len(header):
        (length,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + length].partition(b"=")
        fields[name.decode("ascii", "replace")] = value
        at += 4 + length
    return fields


def _content(file: BinaryIO, path: Path, chunk: _Chunk) -> bytes:
    """Read the records inside a chunk, unpacked."""
    file.seek(chunk.data_at)
    packed = file.read(chunk.data_bytes)
    try:
        if chunk.compression == "lz4":
            return unpack_lz4(packed)
        return bz2.decompress(packed) if chunk.compression == "bz2" else packed
    except (ValueError, OSError) as error:
        raise DataError(f"{path}: the chunk at byte {chunk.at} is damaged: {error}; record again") from error


def _connections(content: bytes) -> dict[int, bytes]:
    """Connection records of a chunk, by their number."""
    found: dict[int, bytes] = {}
    at = 0
    while at + 8 <= len(content):
        (header_size,) = struct.unpack_from("<I", content, at)
        fields = _fields(content[at + 4 : at + 4 + header_size])
        (size,) = struct.unpack_from("<I", content, at + 4 + header_size)
        end = at + 8 + header_size + size
        if fields.get("op") == bytes([_CONNECTION]):
            found[int.from_bytes(fields["conn"], "little")] = content[at:end]
        at = end
    return found


# Writing ------------------------------------------------------------------------------------------


def _write(out: IO[bytes], file: BinaryIO, chunks: list[_Chunk], connections: Mapping[int, bytes]) -> None:
    """Write the chunks unchanged, then what a recorder writes on closing, then the header."""
    start, end = _after_header(file), chunks[-1].end
    file.seek(start)
    out.write(bytes(start))
    while (left := end - file.tell()) > 0:
        out.write(file.read(min(left, 1 << 20)))
    out.writelines(connections[number] for number in sorted(connections))
    out.writelines(_chunk_info(chunk) for chunk in chunks)
    out.seek(0)
    out.write(_START + _bag_header(end, len(connections), len(chunks), start - len(_START)))


def _bag_header(index_at: int, connections: int, chunks: int, record_bytes: int) -> bytes:
    fields = _packed(
        index_pos=struct.pack("<Q", index_at),
        conn_count=struct.pack("<I", connections),
        chunk_count=struct.pack("<I", chunks),
        op=bytes([_BAG]),
    )
    padding = record_bytes - len(fields) - 8
    if padding < 0:
        raise ValueError(f"the header of the bag has only {record_bytes} bytes")
    return struct.pack("<I", len(fields)) + fields + struct.pack("<I", padding) + b" " * padding


def _chunk_info(chunk: _Chunk) -> bytes:
    fields = _packed(
        ver=struct.pack("<I", 1),
        chunk_pos=struct.pack("<Q", chunk.at),
        start_time=struct.pack("<II", *min(chunk.times)),
        end_time=struct.pack("<II", *max(chunk.times)),
        count=struct.pack("<I", len(chunk.counts)),
        op=bytes([_CHUNK_INFO]),
    )
    data = b"".join(struct.pack("<II", *each) for each in sorted(chunk.counts.items()))
    return struct.pack("<I", len(fields)) + fields + struct.pack("<I", len(data)) + data


def _packed(**fields: bytes) -> bytes:
    """Pack the fields of a record's header."""
    parts = [name.encode() + b"=" + value for name, value in fields.items()]
    return b"".join(struct.pack("<I", len(part)) + part for part in parts)
