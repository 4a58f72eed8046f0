"""Convert arrays to JSON-ready lists and back: matrices are row-major, rows not finite become null."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float64

from rpl_data.files import FAULTS
from rpl_data.types import SquareBox

Json = dict[str, Any]
Value = TypeVar("Value")


def taken(data: Json, name: str, convert: Callable[[Any], Value]) -> Value:
    """A field of a record, converted; ValueError naming the field, KeyError where it is missing."""
    try:
        return convert(data[name])
    except KeyError:
        raise
    except FAULTS as error:
        raise ValueError(f"{name}: {error}") from error


def number(value: Any) -> float:
    """A finite number; ValueError for anything else."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(f"{value!r:.60} is not a finite number")
    return float(value)


def positive(value: Any) -> float:
    """A number above 0; ValueError for another one."""
    if number(value) <= 0:
        raise ValueError(f"expected a number above 0, found {value}")
    return float(value)


def whole(value: Any) -> int:
    """A whole number; ValueError for anything else."""
    if not isinstance(value, int) or isinstance(value, bool) or abs(value) >= 2**63:
        raise ValueError(f"{value!r:.60} is not a whole number")
    return value


def text(value: Any) -> str:
    """A text; ValueError for anything else."""
    if not isinstance(value, str):
        raise ValueError(f"{value!r:.60} is not a text")
    return value


def flag(value: Any) -> bool:
    """True or false; ValueError for anything else."""
    if not isinstance(value, bool):
        raise ValueError(f"{value!r:.60} is neither true nor false")
    return value


def mapping(value: Any) -> Json:
    """Values by name; ValueError for anything else."""
    if not isinstance(value, dict):
        raise ValueError(f"{value!r:.60} is no list of names with values")
    return value


def each(convert: Callable[[Any], Value]) -> Callable[[Any], tuple[Value, ...]]:
    """For a list whose items are converted."""

    def converted(values: Any) -> tuple[Value, ...]:
        if not isinstance(values, list):
            raise ValueError(f"{values!r:.60} is not a list")
        return tuple(convert(value) for value in values)

    return converted


def optional(convert: Callable[[Any], Value]) -> Callable[[Any], Value | None]:
    """For a value that may be null."""
    return lambda value: None if value is None else convert(value)


def rows_to_json(rows: Float64[np.ndarray, "n m"], digits: int | None = None) -> list[list[float] | None]:
    """Convert each row to a list; null for a row that is not finite."""
    return [numbers(row, digits) if np.isfinite(row).all() else None for row in rows]


def rows_from_json(rows: list[list[float] | None], width: int) -> Float64[np.ndarray, "n m"]:
    """Convert the result of `rows_to_json` back to an array; NaN for null."""
    filled = [[math.nan] * width if row is None else [*map(number, row)] for row in rows]
    return np.array(filled, dtype=float).reshape(len(rows), width)


def numbers(values: np.ndarray, digits: int | None = None) -> list[float]:
    """Flatten to a list of floats, rounded to `digits` decimals if given."""
    flat = np.ravel(values)
    return [float(x) for x in (flat if digits is None else np.round(flat, digits))]


def matrix_from_json(values: list[float]) -> Float64[np.ndarray, "4 4"]:
    """Make a 4x4 matrix from 16 row-major numbers."""
    return np.array([*map(number, values)], dtype=float).reshape(4, 4)


def asdict_values(box: SquareBox) -> list[float]:
    """cx, cy, side of a square box, as COCO's extra key `square_box` has them."""
    return [box.cx_px, box.cy_px, box.side_px]


def finite_or_none(value: Any) -> Any:
    """Make a value JSON-ready: NaN becomes null, tuples become lists."""
    if isinstance(value, dict):
        return {key: finite_or_none(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite_or_none(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
