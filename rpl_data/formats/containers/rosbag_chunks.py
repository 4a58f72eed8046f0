"""The chunks of a ROS bag (version 2.0): complete ones, and what is whole of the one in which a file ends.

Format: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from rpl_data.files import FAULTS
from rpl_data.formats.containers.rosbag_records import (
    CHUNK,
    CONNECTION,
    INDEX,
    MESSAGE,
    Fields,
    head_of_record,
    packed_record,
    records_in,
    unpacked_chunk,
)
from rpl_data.types import DataError

_LARGEST_CHUNK_BYTES = 2**29
"""Recorders close a chunk at about a megabyte; of one that was cut off no more than this is looked at."""


@dataclass
class Chunk:
    """A chunk with its index.

    Attributes:
        at: offset of its record in the file.
        end: offset after its index.
        data_at: offset of its packed records.
        data_bytes: their size.
        compression: none, lz4 or bz2.
        counts: number of messages per connection.
        times: time of the first and the last message, in seconds and nanoseconds.
        index_fields: names of the fields of its index records, in their order.
    """

    at: int
    end: int
    data_at: int
    data_bytes: int
    compression: str
    counts: dict[int, int] = field(default_factory=dict)
    times: list[tuple[int, int]] = field(default_factory=list)
    index_fields: tuple[str, ...] = ("ver", "conn", "count", "op")


def chunk_at(file: BinaryIO) -> Chunk | None:
    """The chunk that starts here, without its index; None when there is none."""
    at = file.tell()
    record = head_of_record(file)
    if record is None or record[0].get("op") != bytes([CHUNK]):
        return None
    compression = record[0].get("compression", b"none").decode("ascii", "replace")
    return Chunk(at, at, file.tell(), record[1], compression)


def next_chunk(file: BinaryIO) -> Chunk | None:
    """Read the chunk that starts here with its index; None when there is none, or the file ends in them.

    Where no other record follows, the index may lack some connections.
    """
    chunk = chunk_at(file)
    if chunk is None:
        return None
    file.seek(chunk.data_bytes, 1)
    while True:
        end = file.tell()
        record = head_of_record(file)
        if record is None:
            return None
        if record[0].get("op") != bytes([INDEX]):
            chunk.end = end
            file.seek(end)
            return chunk if chunk.counts else None
        _add_index(chunk, record[0], file.read(record[1]))


def _add_index(chunk: Chunk, fields: Fields, data: bytes) -> None:
    """Count the messages of an index record (version 1), which has the time and offset of each."""
    entries = list(struct.iter_unpack("<III", data[: len(data) // 12 * 12]))
    connection = int.from_bytes(fields["conn"], "little")
    chunk.counts[connection] = chunk.counts.get(connection, 0) + len(entries)
    chunk.times += [min(entries)[:2], max(entries)[:2]] if entries else []
    chunk.index_fields = tuple(fields)


def connections_of(file: BinaryIO, path: Path, chunk: Chunk) -> dict[int, bytes]:
    """The records of the connections of a complete chunk, by their number."""
    file.seek(chunk.data_at)
    try:
        return _connections(unpacked_chunk(file.read(chunk.data_bytes), chunk.compression))
    except (ValueError, OSError) as error:
        raise DataError(f"{path}: the chunk at byte {chunk.at} is damaged: {error}; record again") from error


def _connections(content: bytes) -> dict[int, bytes]:
    """The records of the connections in an unpacked chunk, by their number."""
    return {
        int.from_bytes(fields["conn"], "little"): record
        for fields, record in records_in(content)
        if fields.get("op") == bytes([CONNECTION])
    }


# The chunk in which the file ends -----------------------------------------------------------------


def rescue(
    file: BinaryIO, at: int, connections: dict[int, bytes], index_fields: tuple[str, ...]
) -> tuple[Chunk, bytes] | None:
    """A chunk of the complete messages after `at`, with its bytes; None when there are none.

    The connections that it brings are added to `connections`. Its index records have their fields in the
    order of the others: the package `rosbags` looks for them at the same places in each.
    """
    file.seek(at)
    chunk = chunk_at(file)
    if chunk is None:
        return None
    packed = file.read(min(chunk.data_bytes, _LARGEST_CHUNK_BYTES))
    try:
        content = unpacked_chunk(packed, chunk.compression, most_bytes=_LARGEST_CHUNK_BYTES, is_cut=True)
        connections |= _connections(content)
        return _rebuilt(content, at, connections, index_fields)
    except (*FAULTS, struct.error, OSError):
        return None


def _rebuilt(
    content: bytes, at: int, connections: Mapping[int, bytes], index_fields: tuple[str, ...]
) -> tuple[Chunk, bytes] | None:
    """A chunk of the messages in `content` whose connection is known, to be written at `at`."""
    kept, length = [], 0
    index: dict[int, list[tuple[int, int, int]]] = {}
    for fields, record in records_in(content):
        if fields.get("op") not in (bytes([CONNECTION]), bytes([MESSAGE])):
            continue
        number = int.from_bytes(fields["conn"], "little")
        if fields["op"] == bytes([MESSAGE]):
            if number not in connections:
                continue
            seconds, nanoseconds = struct.unpack("<II", fields["time"])
            index.setdefault(number, []).append((seconds, nanoseconds, length))
        kept.append(record)
        length += len(record)
    if not index:
        return None
    whole = packed_record(CHUNK, b"".join(kept), compression=b"none", size=struct.pack("<I", length))
    for number, entries in sorted(index.items()):
        whole += _index_record(number, entries, index_fields)
    counts = {number: len(entries) for number, entries in index.items()}
    times = [entry[:2] for entries in index.values() for entry in entries]
    return Chunk(at, at + len(whole), at, length, "none", counts, [min(times), max(times)]), whole


def _index_record(connection: int, entries: list[tuple[int, int, int]], names: tuple[str, ...]) -> bytes:
    values = {"ver": 1, "conn": connection, "count": len(entries)}
    fields = {name: struct.pack("<I", values[name]) for name in names if name in values}
    data = b"".join(struct.pack("<III", *entry) for entry in entries)
    return packed_record(INDEX, data, **{name: fields.get(name, bytes([INDEX])) for name in names})
