"""Images whose pixels are object numbers: PNG, grey or with a palette."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt16

from rpl_data.files import read_bytes
from rpl_data.types import DataError

SIGNATURE = b"\x89PNG\r\n\x1a\n"
GREY, PALETTE = 0, 3
"""Colour types of PNG (section 11.2.2 of its specification)."""


def read_ids(path: Path, *, size: tuple[int, int]) -> UInt16[np.ndarray, "height width"]:
    """Read the object number of every pixel; 0 = no object.

    With a palette, as DAVIS, SAM 2 and Cutie write them, the number is the index, whatever its colour.

    Args:
        size: height and width of the colour images.

    Raises:
        DataError: no PNG, another size, or colours instead of numbers.
    """
    content = read_bytes(path)
    header = content[16:29]
    if content[:8] != SIGNATURE or len(header) < 13:
        raise DataError(
            f"{path} is no PNG image; masks must be PNG, since JPEG changes the numbers of pixels"
        )
    width, height, bits, kind = struct.unpack(">IIBB", header[:10])
    if (height, width) != size:
        turned = " (as if it were turned: its sides are exchanged)" if (width, height) == size else ""
        raise DataError(
            f"{path} has {width} x {height} px{turned}; expected those of the colour images, "
            f"{size[1]} x {size[0]}: write the masks at full size, not turned"
        )
    if kind not in (GREY, PALETTE):
        raise DataError(
            f"{path} holds colours; expected one channel with 0 and 255, or object numbers, or a palette: "
            "write the masks themselves, not a picture of them"
        )
    if kind == PALETTE:
        content = _without_palette(content)
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.shape != size:
        raise DataError(f"{path} is damaged; write it again")
    if bits < 8:  # the decoder spreads a few bits over 0 to 255
        image = image // (255 // (2**bits - 1))
    return image.astype(np.uint16)


def _without_palette(content: bytes) -> bytes:
    """The same image with its indices as grey values, since OpenCV would replace them by colours."""
    made, start = [SIGNATURE], len(SIGNATURE)
    while start + 8 <= len(content):
        (length,) = struct.unpack(">I", content[start : start + 4])
        kind, body = content[start + 4 : start + 8], content[start + 8 : start + 8 + length]
        if kind == b"IHDR":
            body = body[:9] + bytes([GREY]) + body[10:]
        if kind in (b"IHDR", b"IDAT", b"IEND"):
            checksum = zlib.crc32(kind + body)
            made.append(struct.pack(">I", length) + kind + body + struct.pack(">I", checksum))
        start += 12 + length
    return b"".join(made)
