"""Unpack LZ4 frames, which rosbags compress their chunks with, in pure Python.

Slow (some 5 MB/s), so only the repair of a bag uses it, for the few chunks that name the topics and for the
one in which the file ends: unlike others, it gives what stands before the cut within a block, too.
Format: LZ4 Frame Format Description 1.6 and LZ4 Block Format Description, github.com/lz4/lz4/tree/dev/doc.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

_MAGIC = 0x184D2204
_STORED = 0x80000000
"""Bit of a block's size that means the block is not compressed."""


def unpack_lz4(data: bytes, *, most_bytes: int | None = None, is_cut: bool = False) -> bytes:
    """Unpack the content of one LZ4 frame; checksums are not verified.

    Args:
        data: the frame.
        most_bytes: how much is unpacked at most; everything when None.
        is_cut: the data may end early: what stands before is returned.

    Raises:
        ValueError: the data is not an LZ4 frame, is damaged, or ends too early though `is_cut` is False.
    """
    out = bytearray()
    try:
        for block, is_stored in _blocks(data):
            if is_stored:
                out += block
            else:
                _append_block(out, block, most_bytes)
            if most_bytes is not None and len(out) >= most_bytes:
                break
    except (struct.error, IndexError, EOFError) as error:
        if not is_cut:
            raise ValueError("the LZ4 data is cut off") from error
    return bytes(out[:most_bytes])


def _blocks(data: bytes) -> Iterator[tuple[bytes, bool]]:
    """The blocks of a frame, and whether they are stored as they are; EOFError after one that was cut off."""
    magic, flags = struct.unpack_from("<IB", data)
    if magic != _MAGIC:
        raise ValueError("not LZ4 data")
    has_block_checksum, has_size, has_dictionary = flags & 16, flags & 8, flags & 1
    at = 7 + (8 if has_size else 0) + (4 if has_dictionary else 0)
    while True:
        (size,) = struct.unpack_from("<I", data, at)
        if size == 0:
            return
        at, length = at + 4, size & ~_STORED
        block = data[at : at + length]
        yield block, bool(size & _STORED)
        if len(block) < length:
            raise EOFError
        at += length + (4 if has_block_checksum else 0)


def _append_block(out: bytearray, block: bytes, most_bytes: int | None) -> None:
    """Append sequences of literals, each followed by a match (bytes repeated from earlier output)."""
    at = 0
    while at < len(block) and (most_bytes is None or len(out) < most_bytes):
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
