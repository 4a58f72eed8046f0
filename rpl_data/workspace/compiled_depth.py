"""Rows of depth as two planes of bytes, in compiled code; importing this module imports numba.

A row is stored as the steps from each pixel to the next, small numbers of either sign. They become whole
numbers without a sign (0, -1, 1, -2, ... are 0, 1, 2, 3, ...), and their lower and upper bytes lie apart: the
upper ones are nearly all 0 then, which packs to nothing and unpacks in no time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import UInt8

from rpl_data.compiled import compiled
from rpl_data.types import DepthUnits


def planes_of(units: DepthUnits) -> UInt8[np.ndarray, "2 height width"]:
    """The lower and the upper bytes of an image's steps."""
    planes = np.empty((2, *units.shape), np.uint8)
    _split(np.ascontiguousarray(units), planes)
    return planes


@compiled
def _split(units: Any, planes: Any) -> None:
    for row in range(units.shape[0]):
        before = np.uint16(0)
        for column in range(units.shape[1]):
            step = np.int16(np.uint16(units[row, column] - before))  # modulo 2^16
            sign_last = np.uint16((step << 1) ^ (step >> 15))
            planes[0, row, column] = np.uint8(sign_last & 255)
            planes[1, row, column] = np.uint8(sign_last >> 8)
            before = units[row, column]


@compiled
def fill_window(
    bands: Any, band_rows: int, top: int, rows: Any, columns: Any, unit: float, image: Any
) -> None:
    """Fill in a window of an image: the depth in units of the packed image, times `unit`.

    Args:
        bands: the planes of bands of rows, one after the other; `top` is the first of their rows.
        rows, columns: first and end of the window.
    """
    width = image.shape[1]
    for row in range(rows[0], rows[1]):
        band_top = top + (row - top) // band_rows * band_rows
        # A band has two bytes per pixel. That at the bottom of an image may have fewer rows than the others.
        low = (2 * (band_top - top) + row - band_top) * width
        high = low + min(band_rows, top + len(bands) // (2 * width) - band_top) * width
        value: Any = 0
        for column in range(columns[1]):
            sign_last = np.int32(bands[low + column]) | (np.int32(bands[high + column]) << 8)
            value += (sign_last >> 1) ^ -(sign_last & 1)
            if column >= columns[0]:
                image[row, column] = (value & 65535) * unit
