"""The records that a ROS bag (version 2.0) is made of: read, unpacked, and written.

A record is a header (its length, then fields "name=value", each after its length) and data after its length.
Format: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Iterator, Mapping
from typing import BinaryIO

from rpl_data.formats.containers.lz4 import unpack_lz4

MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7

Fields = Mapping[str, bytes]


def head_of_record(file: BinaryIO) -> tuple[Fields, int] | None:
    """Read the header of the record that starts here, and the size of its data; None when cut off."""
    length = file.read(4)
    header = file.read(int.from_bytes(length, "little"))
    size = file.read(4)
    if len(size) < 4:
        return None
    return _fields(header), int.from_bytes(size, "little")


def records_in(content: bytes) -> Iterator[tuple[Fields, bytes]]:
    """The fields and the bytes of each complete record inside a chunk."""
    at = 0
    while at + 8 <= len(content):
        (header_bytes,) = struct.unpack_from("<I", content, at)
        data_at = at + 8 + header_bytes
        if data_at > len(content):
            return
        end = data_at + int.from_bytes(content[data_at - 4 : data_at], "little")
        if end > len(content):
            return
        yield _fields(content[at + 4 : data_at - 4]), content[at:end]
        at = end


def unpacked_chunk(
    packed: bytes, compression: str, *, most_bytes: int | None = None, is_cut: bool = False
) -> bytes:
    """The records inside a chunk.

    Args:
        packed: what the chunk holds.
        compression: none, lz4 or bz2.
        most_bytes: how much is unpacked at most; everything when None.
        is_cut: the chunk may end early: what can be unpacked before is returned.

    Raises:
        ValueError, OSError: it is damaged, or ends early though `is_cut` is False.
    """
    if compression == "lz4":
        return unpack_lz4(packed, most_bytes=most_bytes, is_cut=is_cut)
    if compression != "bz2":
        return packed
    if not is_cut:
        return bz2.decompress(packed)
    return bz2.BZ2Decompressor().decompress(packed, -1 if most_bytes is None else most_bytes)


def packed_record(kind: int, data: bytes, **fields: bytes) -> bytes:
    """Pack a record of a kind, one of the numbers above; `op` may be given to choose its place."""
    parts = [name.encode() + b"=" + value for name, value in (fields | {"op": bytes([kind])}).items()]
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def _fields(header: bytes) -> Fields:
    fields, at = {}, 0
    while at + 4 <= len(header):
        (length,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + length].partition(b"=")
        fields[name.decode("ascii", "replace")] = value
        at += 4 + length
    return fields
