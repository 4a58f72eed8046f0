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
def fill_rows(planes: Any, first: int, stop: int, unit: float, rows: Any) -> None:
    """Fill in some columns of rows from their planes: the depth in the image's units, times `unit`."""
    for row in range(rows.shape[0]):
        value = 0
        for column in range(stop):
            sign_last = np.int32(planes[0, row, column]) | (np.int32(planes[1, row, column]) << 8)
            value += (sign_last >> 1) ^ -(sign_last & 1)
            if column >= first:
                rows[row, column] = (value & 65535) * unit
