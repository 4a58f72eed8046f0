"""Save the images of a live camera, or of a recording that is a single file, as files of their own.

::

    <folder>/rgb/000000.jpg      the camera's own JPEG where it made one, else PNG, or JPEG of quality 95
             depth/000000.png    16 bit
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import UInt8, UInt16

from rpl_data.files import write_bytes

JPEG_QUALITY = 95


def write_images(
    folder: Path,
    index: int,
    color: UInt8[np.ndarray, "height width 3"] | bytes,
    depth: UInt16[np.ndarray, "rows columns"],
    *,
    lossless: bool = False,
) -> tuple[Path, Path]:
    """Write a frame, each file completely or not at all; returns the paths of colour and depth.

    Args:
        folder: folder of the scene.
        index: `Frame.index`.
        color: RGB, or the bytes of a JPEG file, which are written unchanged.
        depth: depth in the units of the recording.
        lossless: write RGB as PNG, about five times the size.
    """
    return write_color(folder, index, color, lossless=lossless), write_depth(folder, index, depth)


def write_color(
    folder: Path, index: int, color: UInt8[np.ndarray, "height width 3"] | bytes, *, lossless: bool = False
) -> Path:
    """Write a colour image, RGB or the bytes of a JPEG or PNG file, and return its path."""
    if isinstance(color, bytes):
        kept = "png" if color.startswith(b"\x89PNG") else "jpg"
        path = folder / "rgb" / f"{index:06d}.{kept}"
        write_bytes(path, color)
        return path
    suffix: Literal["png", "jpg"] = "png" if lossless else "jpg"
    path = folder / "rgb" / f"{index:06d}.{suffix}"
    write_bytes(path, encoded(color[..., ::-1], suffix))
    return path


def write_depth(folder: Path, index: int, depth: UInt16[np.ndarray, "height width"]) -> Path:
    """Write a depth image and return its path."""
    path = folder / "depth" / f"{index:06d}.png"
    write_bytes(path, encoded(depth, "png"))
    return path


def encoded(image: np.ndarray, suffix: Literal["png", "jpg"]) -> bytes:
    """Encode an image (colours in BGR order) to the bytes of a file.

    PNG uses the fastest level: depth is 10 % larger than at the best level and five times quicker.
    """
    options = {
        "png": [cv2.IMWRITE_PNG_COMPRESSION, 1],
        "jpg": [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY],
    }
    content: bytes = cv2.imencode(f".{suffix}", image, options[suffix])[1].tobytes()
    return content
