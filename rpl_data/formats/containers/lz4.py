"""Unpack LZ4 frames, which rosbags compress their chunks with, in pure Python.

Slow (some 5 MB/s), so only the repair of a bag uses it, for the few chunks that name the topics.
Format: LZ4 Frame Format Description 1.6 and LZ4 Block Format Description, github.com/lz4/lz4/tree/dev/doc.
"""

from __future__ import annotations

import struct

_MAGIC = 0x184D2204
_STORED = 0x80000000
"""Bit of a block's size that means the block is not compressed."""


def unpack_lz4(data: bytes) -> bytes:
    """Unpack the content of one LZ4 frame; checksums are not verified.

    Raises:
        ValueError: the data is not an LZ4 frame, or ends too early.
    """
    try:
        return bytes(_frame(data))
    except (struct.error, IndexError) as error:
        raise ValueError("the LZ4 data is cut off") from error


def _frame(data: bytes) -> bytearray:
    magic, flags = struct.unpack_from("<IB", data)
    if magic != _MAGIC:
        raise ValueError("not LZ4 data")
    has_block_checksum, has_size, has_dictionary = flags & 16, flags & 8, flags & 1
    at = 7 + (8 if has_size else 0) + (4 if has_dictionary else 0)
    out = bytearray()
    while True:
        (size,) = struct.unpack_from("<I", data, at)
        if size == 0:
            return out
        at, length = at + 4, size & ~_STORED
        block = data[at : at + length]
        if len(block) < length:
            raise ValueError("the LZ4 data is cut off")
        if size & _STORED:
            out += block
        else:
            _append_block(out, block)
        at += length + (4 if has_block_checksum else 0)


def _append_block(out: bytearray, block: bytes) -> None:
    """Append sequences of literals, each followed by a match (bytes repeated from earlier output)."""
    at = 0
    while at < len(block):
        token = block[at]
        literals, at = _length(block, at + 1, token >> 4)
        out += block[at : at + literals]
        at += literals
        if at >= len(block):  # the last sequence has no match
            return
        offset = block[at] | block[at + 1] << 8
        length, at = _length(block, at + 2, token & 15)
        length += 4
        if not 0 < offset <= len(out):
            raise ValueError("the LZ4 data is damaged")
        pattern = out[-offset:][:length]
        out += (pattern * (length // len(pattern) + 1))[:length]


def _length(block: bytes, at: int, nibble: int) -> tuple[int, int]:
    """Read a length that starts with `nibble`; returns it and the position after it."""
    if nibble < 15:
        return nibble, at
    while block[at] == 255:
        nibble, at = nibble + 255, at + 1
    return nibble + block[at], at + 1
