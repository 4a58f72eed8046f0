"""Read the header of an image file and check that it is complete, from its first and last bytes only."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np

from rpl_data.files import read_bytes
from rpl_data.orientation import without_orientation

_PNG_START = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"IEND\xaeB\x60\x82"
_JPEG_START = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"
# SOF0..SOF15 without DHT (C4), JPG (C8) and DAC (CC): the markers that carry the image's size.
_JPEG_SIZES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


@dataclass(frozen=True)
class ImageHeader:
    """Size in pixels, and whether it is a 16-bit image of one channel, as depth images are."""

    width: int
    height: int
    is_depth: bool


def probe(path: Path) -> ImageHeader | None:
    """Read the header of an image file; None when it is missing, cut off or not an image.

    PNG and JPEG are judged by their header and end mark, so 10,000 frames are checked in about a second; a
    file that is damaged in between is found when it is decoded. Other formats are decoded.
    """
    try:
        with path.open("rb") as file:
            start = file.read(26)
            end = _tail(file)
            if start.startswith(_PNG_START):
                return _png(start) if _PNG_END in end else None
            if start.startswith(_JPEG_START):
                return _jpeg(file) if _JPEG_END in end else None
    except OSError:
        return None
    return _decoded(path)


def _tail(file: BinaryIO) -> bytes:
    """The last bytes; some cameras pad a JPEG after its end mark."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - 64))
    return file.read()


def _png(start: bytes) -> ImageHeader | None:
    if len(start) < 26 or start[12:16] != b"IHDR":
        return None
    width, height = int.from_bytes(start[16:20]), int.from_bytes(start[20:24])
    return ImageHeader(width, height, is_depth=start[24] == 16 and start[25] == 0)


def _jpeg(file: BinaryIO) -> ImageHeader | None:
    """Walk the segments (marker, length, content) up to the one with the size."""
    file.seek(2)
    while True:
        segment = file.read(4)
        if len(segment) < 4 or segment[0] != 0xFF:
            return None
        if segment[1] in _JPEG_SIZES:
            size = file.read(5)
            if len(size) < 5:
                return None
            return ImageHeader(int.from_bytes(size[3:5]), int.from_bytes(size[1:3]), is_depth=False)
        if (length := int.from_bytes(segment[2:4])) < 2:
            return None
        file.seek(length - 2, os.SEEK_CUR)


def _decoded(path: Path) -> ImageHeader | None:
    content = np.frombuffer(without_orientation(read_bytes(path)), np.uint8)  # OpenCV would turn a TIFF
    image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if len(content) else None
    if image is None:
        return None
    return ImageHeader(image.shape[1], image.shape[0], is_depth=image.dtype == np.uint16 and image.ndim == 2)
