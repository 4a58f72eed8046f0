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
SOFT_LEVELS = 3
"""Fewer grey levels between 0 and 255 are object numbers."""
HALF = 128
"""Where a soft edge is the outline."""
LEAST_SOLID = 0.1
"""A mask with soft edges is 255 on this share of the object at least."""


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
    if kind == PALETTE:
        content = _without_palette(content)
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.shape[:2] != size:
        raise DataError(f"{path} is damaged; write it again")
    if image.ndim == 3:
        image = _one_channel(path, image)
    if bits < 8:  # the decoder spreads a few bits over 0 to 255
        image = image // (255 // (2**bits - 1))
    if kind != PALETTE and image.dtype == np.uint8:
        image = _without_soft_edges(path, image)
    return image.astype(np.uint16)


def _one_channel(path: Path, image: np.ndarray) -> np.ndarray:
    """The grey values of an image with three channels that are equal, with or without transparency."""
    first = image[..., 0]
    if image.shape[2] >= 3 and not (image[..., 1:3] == first[..., None]).all():
        raise DataError(
            f"{path} holds colours; expected one channel with 0 and 255, or object numbers, or a palette: "
            "write the masks themselves, not a picture of them"
        )
    return np.ascontiguousarray(first)


def _without_soft_edges(path: Path, image: np.ndarray) -> np.ndarray:
    """A mask whose edges fade from 255 to 0, cut at the half; object numbers stay as they are.

    Raises:
        DataError: grey values that fade everywhere, which are neither.
    """
    between = (image > 0) & (image < 255)
    levels = len(np.unique(image[between]))
    if levels < SOFT_LEVELS or not _fades(image, between):
        return image
    if np.count_nonzero(image == 255) < LEAST_SOLID * np.count_nonzero(image):
        raise DataError(
            f"{path} has {levels} grey levels that fade into one another, so they are no object numbers; "
            "write the mask with 0 and 255 alone, such as where the prediction is above one half"
        )
    return np.where(image >= HALF, 255, 0).astype(np.uint8)


def _fades(image: np.ndarray, between: np.ndarray) -> bool:
    """Whether most pixels between 0 and 255 differ from a neighbour: a gradient, not areas of one number."""
    right, down = np.zeros_like(between), np.zeros_like(between)
    right[:, :-1], down[:-1] = image[:, :-1] != image[:, 1:], image[:-1] != image[1:]
    return float((right | down)[between].mean()) > 0.5


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
