"""Depth images that are not 16-bit PNG: npy, EXR, TIFF, two bytes in two channels, doubtful pixels marked.

They are rewritten once as 16-bit PNG, which is what all stages, the export and other people's readers take.
"""

from __future__ import annotations

from pathlib import Path
from tokenize import TokenError
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, UInt16

from rpl_data.files import FAULTS, read_bytes
from rpl_data.formats.containers.exr import MOST_PIXELS, read_exr
from rpl_data.orientation import without_orientation
from rpl_data.types import DataError

STORED_UNIT_M = 0.00025
"""Unit of depth that came as metres: 16 bits then reach 16 m, and rounding is a tenth of any noise."""

SUFFIXES = (".png", ".npy", ".exr", ".tiff", ".tif")
"""Files that a depth image may be in."""

PACKED_UNIT_M = 0.00012498664727900177
"""HO3D's unit, that of its RealSense SR300 (github.com/shreyashampali/ho3d, vis_HO3D.py)."""

MOST_METRES = 50.0
"""Decimal numbers with a larger median are millimetres."""


def read_depth_file(path: Path) -> np.ndarray:
    """Read a depth image as it is stored, 2D, whole numbers or float; DataError when it is damaged.

    HO3D packs 16 bits into two channels of an 8-bit image: red + 256 green.
    """
    if path.suffix.lower() == ".npy":
        return _plane(path, read_npy(path))
    if path.suffix.lower() == ".exr":
        return read_exr(path)
    image = _image(path) if path.is_file() else None
    if image is None:
        raise DataError(f"{path} is no image, or damaged; copy it again")
    if image.ndim == 3 and image.dtype == np.uint8 and image.shape[2] >= 3:
        return image[..., 2].astype(np.uint16) + 256 * image[..., 1].astype(np.uint16)
    return _plane(path, image)


def _image(path: Path) -> np.ndarray | None:
    """The pixels as they are stored: OpenCV turns a TIFF by its tag, whatever the flags say."""
    if path.suffix.lower() == ".png":
        return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    content = np.frombuffer(without_orientation(read_bytes(path)), np.uint8)
    return cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if len(content) else None


def is_packed(path: Path) -> bool:
    """Whether a PNG holds depth as two bytes in the channels of a colour image: 8 bits, no blue."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.suffix == ".png" else None
    return image is not None and image.ndim == 3 and image.dtype == np.uint8 and not image[..., 0].any()


def read_npy(path: Path) -> np.ndarray:
    """Read an array of numbers that is no larger than an image; DataError when it is damaged."""
    try:
        shape = np.load(path, mmap_mode="r", allow_pickle=False).shape
        if int(np.prod(shape)) > MOST_PIXELS:
            raise ValueError(f"it holds {shape} numbers")
        content: np.ndarray = np.load(path, allow_pickle=False)
    except (*FAULTS, OSError, SyntaxError, TokenError) as error:
        raise DataError(f"{path} is no array that can be read: {error}; copy it again") from error
    return content


def _plane(path: Path, image: np.ndarray) -> np.ndarray:
    """The image without axes of length 1; DataError when it is no single plane of numbers."""
    plane = image.squeeze()
    if plane.ndim != 2 or plane.dtype.kind not in "uif" or not plane.size:
        raise DataError(f"{path} should be one plane of numbers, found {image.dtype} {image.shape}")
    return plane


def stored_units(
    depth: np.ndarray,
    metres_per_unit: float | None,
    confident: Bool[np.ndarray, "height width"] | None = None,
) -> UInt16[np.ndarray, "height width"]:
    """Whole 16-bit numbers of a depth image; 0 where there is none, or where it is not to be trusted.

    Args:
        depth: whole numbers, kept as they are, or decimal ones, which become `STORED_UNIT_M`.
        metres_per_unit: of decimal numbers; None for whole ones.
        confident: which pixels to keep, of any size with the same shape of image; all when left out.
    """
    units: Any = depth
    if metres_per_unit is not None:
        units = depth.astype(np.float64) * (metres_per_unit / STORED_UNIT_M)
    with np.errstate(invalid="ignore"):
        usable = np.isfinite(units) & (units > 0) & (units < 65535)
    if confident is not None:
        size = depth.shape[1], depth.shape[0]
        usable &= cv2.resize(confident.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    return np.where(usable, np.rint(np.where(usable, units, 0)), 0).astype(np.uint16)


def unit_of_decimals(depth: np.ndarray) -> float:
    """Metres per unit of decimal depth: 1, or 0.001 where its median could not be metres of a room."""
    measured = depth[np.isfinite(depth) & (depth > 0)]
    return 0.001 if len(measured) and float(np.median(measured)) > MOST_METRES else 1.0
