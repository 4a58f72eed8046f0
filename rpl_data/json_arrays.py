"""Convert arrays to JSON-ready lists and back: matrices are row-major, rows not finite become null."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float64

from rpl_data.types import (
    SquareBox,
)

Json = dict[str, Any]


def rows_to_json(rows: Float64[np.ndarray, "n m"], digits: int | None = None) -> list[list[float] | None]:
    """Convert each row to a list; null for a row that is not finite."""
    return [numbers(row, digits) if np.isfinite(row).all() else None for row in rows]


def rows_from_json(rows: list[list[float] | None], width: int) -> Float64[np.ndarray, "n m"]:
    """Convert the result of `rows_to_json` back to an array; NaN for null."""
    filled = [[math.nan] * width if row is None else row for row in rows]
    return np.array(filled, dtype=float).reshape(len(rows), width)


def numbers(values: np.ndarray, digits: int | None = None) -> list[float]:
    """Flatten to a list of floats, rounded to `digits` decimals if given."""
    flat = np.ravel(values)
    return [float(x) for x in (flat if digits is None else np.round(flat, digits))]


def matrix_from_json(values: list[float]) -> Float64[np.ndarray, "4 4"]:
    """Make a 4x4 matrix from 16 row-major numbers."""
    return np.array(values, dtype=float).reshape(4, 4)


def asdict_values(box: SquareBox) -> list[float]:
    """cx, cy, side of a square box, as COCO's extra key `square_box` has them."""
    return [box.cx_px, box.cy_px, box.side_px]
