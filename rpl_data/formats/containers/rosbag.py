"""Repair a ROS bag (version 2.0) that its recorder never closed, or that was cut off.

A bag is a list of records: its header, then chunks of messages, each followed by its index. The topics and
the positions of the chunks are written at the end, on closing; without them no player opens the file.
All of this can be recovered from the chunks that are complete, as `rosbag reindex` does. Of the chunk in
which the file ends, the messages before the end are packed into a chunk of their own.
Format: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, BinaryIO

from rpl_data.files import decoding, refuse_special, writing
from rpl_data.formats.containers.rosbag_chunks import Chunk, connections_of, next_chunk, rescue
from rpl_data.formats.containers.rosbag_records import BAG, CHUNK_INFO, head_of_record, packed_record
from rpl_data.types import DataError

_START = b"#ROSBAG V2.0\n"


@dataclass(frozen=True)
class BagRepair:
    """Result of a repair.

    Attributes:
        messages: number of complete messages.
        seconds: time from the first of them to the last.
    """

    messages: int
    seconds: float


def repair_bag(path: Path, repaired: Path) -> BagRepair:
    """Write `repaired`: the complete messages of a bag, with everything that a closed bag has.

    Raises:
        DataError: the file is not a bag, or has no complete message.
    """
    refuse_special(path)
    with decoding(path, "record it again"):
        return _repaired(path, repaired)


def _repaired(path: Path, repaired: Path) -> BagRepair:
    with path.open("rb") as file:
        chunks, connections, rest = _scan(file, path)
        with writing(repaired, "wb") as out:
            _write(out, file, chunks, connections, rest)
    times = [time for chunk in chunks for time in chunk.times]
    (first_s, first_ns), (last_s, last_ns) = min(times), max(times)
    seconds = last_s - first_s + (last_ns - first_ns) * 1e-9
    return BagRepair(sum(sum(chunk.counts.values()) for chunk in chunks), seconds)


def _scan(file: BinaryIO, path: Path) -> tuple[list[Chunk], dict[int, bytes], bytes]:
    """Find the complete chunks in order, the records of the connections they use, and what replaces the rest.

    The rest is empty, or a chunk and its index, made of the complete messages of the chunk in which the file
    ends; it belongs at the end of the last complete chunk, and is the last chunk of the list.
    """
    file.seek(0)
    if file.read(len(_START)) != _START:
        raise DataError(f"{path} is not a ROS bag of version 2.0; expected a recording of a RealSense camera")
    file.seek(_after_header(file))
    chunks: list[Chunk] = []
    connections: dict[int, bytes] = {}
    at = file.tell()
    while (chunk := next_chunk(file)) is not None:
        if set(chunk.counts) - set(connections):
            connections |= connections_of(file, path, chunk)
            file.seek(chunk.end)
        chunks.append(chunk)
        at = chunk.end
    rest = rescue(file, at, connections, chunks[0].index_fields if chunks else Chunk.index_fields)
    if rest is not None:
        chunks.append(rest[0])
    if not any(chunk.times for chunk in chunks):
        raise DataError(f"{path} was cut off before its first complete message; nothing of it can be kept")
    return chunks, connections, b"" if rest is None else rest[1]


def _after_header(file: BinaryIO) -> int:
    """Where the record of the bag's header ends; it is padded, so that it can be rewritten in place.

    ROS and librealsense pad it to 4104 bytes, the package `rosbags` to 4096.
    """
    file.seek(len(_START))
    record = head_of_record(file)
    return file.tell() + (0 if record is None else record[1])


# Writing ------------------------------------------------------------------------------------------


def _write(
    out: IO[bytes],
    file: BinaryIO,
    chunks: list[Chunk],
    connections: Mapping[int, bytes],
    rest: bytes,
) -> None:
    """Write the chunks unchanged and the rest, then what a recorder writes on closing, then the header."""
    start, end = _after_header(file), chunks[-1].end
    file.seek(start)
    out.write(bytes(start))
    while (left := end - len(rest) - file.tell()) > 0:
        out.write(file.read(min(left, 1 << 20)))
    out.write(rest)
    out.writelines(connections[number] for number in sorted(connections))
    out.writelines(_chunk_info(chunk) for chunk in chunks)
    out.seek(0)
    out.write(_START + _bag_header(end, len(connections), len(chunks), start - len(_START)))


def _bag_header(index_at: int, connections: int, chunks: int, record_bytes: int) -> bytes:
    fields = {
        "index_pos": struct.pack("<Q", index_at),
        "conn_count": struct.pack("<I", connections),
        "chunk_count": struct.pack("<I", chunks),
    }
    padding = record_bytes - len(packed_record(BAG, b"", **fields))
    if padding < 0:
        raise ValueError(f"the header of the bag has only {record_bytes} bytes")
    return packed_record(BAG, b" " * padding, **fields)


def _chunk_info(chunk: Chunk) -> bytes:
    return packed_record(
        CHUNK_INFO,
        b"".join(struct.pack("<II", *each) for each in sorted(chunk.counts.items())),
        ver=struct.pack("<I", 1),
        chunk_pos=struct.pack("<Q", chunk.at),
        start_time=struct.pack("<II", *min(chunk.times)),
        end_time=struct.pack("<II", *max(chunk.times)),
        count=struct.pack("<I", len(chunk.counts)),
    )
