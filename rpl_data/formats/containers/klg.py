"""ElasticFusion's log (.klg): one file with all frames of a recording.

::

    int32 number of frames
    per frame: int64 time in microseconds, int32 size of depth, int32 size of colour, depth, colour

Little-endian. Depth is zlib-packed, or raw when it has 2 bytes per pixel; uint16 millimetres. Colour is a
JPEG, raw when it has 3 bytes per pixel, black when it has none. The image size is not stored: a JPEG holds
it, otherwise the number of depth pixels must be that of a common camera.

The count is written when a logger ends normally: it is 0 or too large in a log that was cut off, so frames
are read as long as they are complete, whatever the count says.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np
from jaxtyping import UInt8, UInt16

from rpl_data.files import opened, writing
from rpl_data.images import decode_pixels
from rpl_data.types import DataError

METRES_PER_UNIT = 0.001
_COUNT = struct.Struct("<i")
_HEADER = struct.Struct("<qii")
_LARGEST_BYTES = 100_000_000
"""No image is larger, packed or unpacked; a greater size in a header is not one."""

SIZES = ((640, 480), (320, 240), (160, 120), (848, 480), (1280, 720), (1920, 1080), (1280, 800), (512, 424))
"""Width and height of common cameras, no two with the same number of pixels."""


@dataclass(frozen=True)
class KlgEntry:
    """Position of a frame in the log.

    Attributes:
        time: the stored number, microseconds by the format; png_to_klg stores the digits of any number.
        depth_at: offset of the depth in the file; colour follows it.
    """

    time: int
    depth_at: int
    depth_bytes: int
    color_bytes: int


@dataclass(frozen=True)
class KlgIndex:
    """All complete frames of a log.

    Attributes:
        promised: the count in the header.
        lost_bytes: bytes after the last complete frame.
    """

    entries: tuple[KlgEntry, ...]
    promised: int
    lost_bytes: int


def index_klg(path: Path) -> KlgIndex:
    """Find the frames without decoding them: constant time per frame, memory for the index only.

    Raises:
        DataError: the file is missing, or does not start with a frame.
    """
    with opened(path) as file:
        return _index(file, path)


def _index(file: BinaryIO, path: Path) -> KlgIndex:
    size = file.seek(0, 2)
    file.seek(0)
    head = file.read(_COUNT.size)
    entries: list[KlgEntry] = []
    at = len(head)
    while len(header := file.read(_HEADER.size)) == _HEADER.size:
        time, depth, color = _HEADER.unpack(header)
        end = at + _HEADER.size + depth + color
        if not (0 < depth < _LARGEST_BYTES and 0 <= color < _LARGEST_BYTES) or end > size:
            break
        entries.append(KlgEntry(time, at + _HEADER.size, depth, color))
        at = end
        file.seek(at)
    if not entries:
        raise DataError(f"{path} is not an ElasticFusion log (.klg) with a complete frame; record it again")
    return KlgIndex(tuple(entries), _COUNT.unpack(head)[0], size - at)


# Pixels -------------------------------------------------------------------------------------------


def klg_depth_mm(
    file: BinaryIO, entry: KlgEntry, size: tuple[int, int]
) -> UInt16[np.ndarray, "height width"] | None:
    """Read the depth of a frame from an open log; None when it is damaged."""
    width, height = size
    depth = _depth_bytes(file, entry, width * height)
    if depth is None or len(depth) != 2 * width * height:
        return None
    return np.frombuffer(depth, dtype="<u2").reshape(height, width).astype(np.uint16)


def klg_color(
    file: BinaryIO, entry: KlgEntry, size: tuple[int, int], *, bgr: bool = False
) -> UInt8[np.ndarray, "height width 3"] | bytes | None:
    """Read the colour of a frame: RGB, or the JPEG it was stored as; None when it is damaged.

    Args:
        file: the log, open.
        entry: the frame's entry in the index.
        size: width and height.
        bgr: colours were stored in the order blue, green, red (as for ElasticFusion's option -f).
    """
    width, height = size
    file.seek(entry.depth_at + entry.depth_bytes)
    stored = file.read(entry.color_bytes)
    if not stored:
        return np.zeros((height, width, 3), np.uint8)
    if len(stored) == 3 * width * height:
        color = np.frombuffer(stored, dtype=np.uint8).reshape(height, width, 3)
        return np.ascontiguousarray(color[..., ::-1]) if bgr else color
    if not bgr:
        return stored
    decoded = _jpeg(stored)
    return None if decoded is None else np.ascontiguousarray(decoded[..., ::-1])


def _depth_bytes(file: BinaryIO, entry: KlgEntry, pixels: int | None) -> bytes | None:
    file.seek(entry.depth_at)
    stored = file.read(entry.depth_bytes)
    if pixels is not None and len(stored) == 2 * pixels:
        return stored
    most = _LARGEST_BYTES if pixels is None else 2 * pixels + 1  # one more tells that it is too long
    try:
        return zlib.decompressobj().decompress(stored, most)  # a megabyte may unpack to gigabytes
    except zlib.error:
        return None


def _jpeg(stored: bytes) -> np.ndarray | None:
    return decode_pixels(stored)


def klg_image_size(path: Path, index: KlgIndex) -> tuple[int, int]:
    """Find width and height of the images, from the first frame that shows them.

    Raises:
        DataError: no frame shows them.
    """
    found = []
    with path.open("rb") as file:
        for entry in index.entries[:10]:
            file.seek(entry.depth_at + entry.depth_bytes)
            stored = file.read(entry.color_bytes)
            image = _jpeg(stored) if stored.startswith(b"\xff\xd8") else None
            if image is not None:
                return image.shape[1], image.shape[0]
            found.append(_pixels(file, entry))
    for width, height in SIZES:
        if width * height in found:
            return width, height
    raise DataError(
        f"{path}: the size of its images is unknown: colour is not JPEG, and {found[0] or 'no'} depth pixels "
        f"are none of {', '.join(f'{w}x{h}' for w, h in SIZES)}; write it again with JPEG colour"
    )


def _pixels(file: BinaryIO, entry: KlgEntry) -> int | None:
    """Number of pixels of the depth image; None when it is damaged."""
    if entry.color_bytes == 3 * entry.depth_bytes // 2:
        return entry.depth_bytes // 2
    unpacked = _depth_bytes(file, entry, None)
    return entry.depth_bytes // 2 if unpacked is None else len(unpacked) // 2


# Writing ------------------------------------------------------------------------------------------


def write_klg(
    path: Path,
    frames: Iterable[tuple[int, UInt16[np.ndarray, "h w"], UInt8[np.ndarray, "h w 3"] | None]],
    *,
    packed: bool = True,
) -> int:
    """Write a log and return its number of frames.

    Args:
        path: the file to write.
        frames: time in microseconds, depth in millimetres, RGB or None for black, per frame.
        packed: zlib depth and JPEG colour; otherwise raw.
    """
    count = 0
    with writing(path, "wb") as file:
        file.write(_COUNT.pack(0))
        for time_us, depth_mm, color in frames:
            depth, image = _stored(depth_mm, color, packed)
            file.write(_HEADER.pack(time_us, len(depth), len(image)) + depth + image)
            count += 1
        file.seek(0)
        file.write(_COUNT.pack(count))
    return count


def _stored(depth_mm: np.ndarray, color: np.ndarray | None, packed: bool) -> tuple[bytes, bytes]:
    depth = depth_mm.astype("<u2").tobytes()
    if not packed:
        return depth, b"" if color is None else color.tobytes()
    if color is None:
        return zlib.compress(depth), b""
    quality = [cv2.IMWRITE_JPEG_QUALITY, 95]
    return zlib.compress(depth), cv2.imencode(".jpg", color[..., ::-1], quality)[1].tobytes()
