"""Read one channel of an OpenEXR image, as exported depth is stored: scan lines, half or float numbers.

Format: OpenEXR File Layout and Technical Introduction (openexr.com). Uncompressed, RLE and zip images are
read; tiles, several parts, and the wavelet and lossy compressions are refused. OpenCV's reader is left out of
many of its builds, and FFmpeg's knows no image whose only channel is called R, as Record3D's is.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from rpl_data.files import read_bytes
from rpl_data.types import DataError
from rpl_data.wording import counted

MOST_PIXELS = 2**26
"""Largest image that is read: 8192 x 8192 pixels."""

_MAGIC = b"\x76\x2f\x31\x01"
_TYPES: dict[int, np.dtype] = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}
_LINES = {0: 1, 1: 1, 2: 1, 3: 16}
"""Scan lines per block by compression: none, RLE, zip of a line, zip of 16 lines."""

_REFUSED = ("PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB")
"""Names of the compressions from number 4 on."""

_MOST_BLOCK_BYTES = 2**26
"""Of 16 scan lines: of 8192 pixels in 128 channels of 4 bytes. A few bytes never unpack to gigabytes."""

_BEST = ("Z", "depth", "D", "R", "Y", "A", "G", "B")
"""Names of the channel with the depth, the likeliest first."""


@dataclass(frozen=True)
class _Header:
    channels: dict[str, np.dtype]
    compression: int
    width: int
    height: int
    end: int


def read_exr(path: Path) -> Float32[np.ndarray, "height width"]:
    """Read the channel of an image that holds depth; errors as `decoded_exr`."""
    return decoded_exr(read_bytes(path), path)


def decoded_exr(data: bytes, path: Path) -> Float32[np.ndarray, "height width"]:
    """Decode the channel that holds depth: its only one, or Z, R, Y.

    Args:
        data: content of the file.
        path: the file, for messages.

    Raises:
        DataError: it is no such image, it was cut off, or it is stored in a way that is not read.
    """
    try:
        return _decode(data)
    except (struct.error, zlib.error, IndexError, KeyError, ValueError, OverflowError) as error:
        raise DataError(
            f"{path} is not an EXR image that can be read ({error}); export the depth as 16-bit PNG, or as "
            "EXR with scan lines and zip compression"
        ) from error


def _decode(data: bytes) -> Float32[np.ndarray, "height width"]:
    header = _header(data)
    name = next((best for best in _BEST if best in header.channels), next(iter(header.channels)))
    image = np.zeros((header.height, header.width), np.float32)
    before = 0
    for channel, kind in header.channels.items():
        if channel == name:
            break
        before += kind.itemsize * header.width
    kind = header.channels[name]
    line_bytes = sum(one.itemsize for one in header.channels.values()) * header.width
    if _LINES[header.compression] * line_bytes > _MOST_BLOCK_BYTES:
        raise ValueError(f"{counted(len(header.channels), 'channel')} of {header.width} pixels per line")
    for row, block in _blocks(data, header, line_bytes):
        for number in range(len(block) // line_bytes):
            at = number * line_bytes + before
            image[row + number] = np.frombuffer(block, kind, header.width, at)
    return image


def _header(data: bytes) -> _Header:
    if not data.startswith(_MAGIC):
        raise ValueError("no EXR image")
    (version,) = struct.unpack_from("<I", data, 4)
    if version & 0x1A00:
        raise ValueError("tiles, deep pixels or several parts")
    attributes: dict[str, bytes] = {}
    at = 8
    while data[at]:
        name, at = _text(data, at)
        _, at = _text(data, at)
        (size,) = struct.unpack_from("<I", data, at)
        attributes[name] = data[at + 4 : at + 4 + size]
        at += 4 + size
    left, top, right, bottom = struct.unpack_from("<4i", attributes["dataWindow"])
    width, height, compression = right - left + 1, bottom - top + 1, attributes["compression"][0]
    if min(width, height) <= 0 or width * height > MOST_PIXELS:
        raise ValueError(f"{width} x {height} pixels")
    if compression not in _LINES:
        name = _REFUSED[compression - 4] if 0 <= compression - 4 < len(_REFUSED) else f"number {compression}"
        raise ValueError(f"its compression is {name}")
    return _Header(_channels(attributes["channels"]), compression, width, height, at + 1)


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(0, at, at + 256)
    return data[at:end].decode("latin-1"), end + 1


def _channels(packed: bytes) -> dict[str, np.dtype]:
    found: dict[str, np.dtype] = {}
    at = 0
    while packed[at]:
        name, at = _text(packed, at)
        kind, _, along_u, along_v = struct.unpack_from("<iIii", packed, at)
        if (along_u, along_v) != (1, 1):
            raise ValueError("channels of different sizes")
        found[name] = _TYPES[kind]
        at += 16
    if not found:
        raise ValueError("no channel")
    return found


def _blocks(data: bytes, header: _Header, line_bytes: int) -> Iterator[tuple[int, bytes]]:
    """First row and pixels of each block of scan lines, in the order of the file."""
    lines = _LINES[header.compression]
    count = -(-header.height // lines)
    (first,) = struct.unpack_from("<i", data, struct.unpack_from("<Q", data, header.end)[0])
    for offset in struct.unpack_from(f"<{count}Q", data, header.end):
        row, size = struct.unpack_from("<iI", data, offset)
        row -= first
        if not 0 <= row < header.height:
            raise ValueError("a row outside the image")
        wanted = min(lines, header.height - row) * line_bytes
        packed = data[offset + 8 : offset + 8 + size]
        if len(packed) < size:
            raise ValueError("it was cut off")
        yield row, packed if size == wanted else _unpacked(packed, header.compression, wanted)


def _unpacked(packed: bytes, compression: int, wanted: int) -> bytes:
    """Undo the compression, then the differences of neighbouring bytes, then the split of their order."""
    content = _unpacked_runs(packed, wanted) if compression == 1 else _inflated(packed, wanted)
    if len(content) != wanted:
        raise ValueError("a block of another size")
    steps = np.frombuffer(content, np.uint8).astype(np.int64)
    steps[1:] -= 128
    bytes_ = (np.cumsum(steps) & 255).astype(np.uint8)
    order = np.empty_like(bytes_)
    half = (wanted + 1) // 2
    order[0::2], order[1::2] = bytes_[:half], bytes_[half:]
    return order.tobytes()


def _inflated(packed: bytes, wanted: int) -> bytes:
    return zlib.decompressobj().decompress(packed, wanted + 1)  # one byte more tells that there is more


def _unpacked_runs(packed: bytes, wanted: int) -> bytes:
    out = bytearray()
    at = 0
    while at < len(packed) and len(out) <= wanted:
        count = packed[at] - 256 if packed[at] > 127 else packed[at]
        if count < 0:
            out += packed[at + 1 : at + 1 - count]
            at += 1 - count
        else:
            out += packed[at + 1 : at + 2] * (count + 1)
            at += 2
    return bytes(out)
