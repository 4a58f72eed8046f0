"""Rules for the values of an export: each raises a ValueError where a value is not as it must be."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from rpl_data.json_arrays import each, number, whole
from rpl_data.json_arrays import positive as positive

Rule = Callable[[Any], object]
Rules = Mapping[str, Rule]

ROTATION_SKEW = 1e-4
"""How far a rotation may be from orthonormal: more than rounding to nine digits does."""
FARTHEST = 1e8
"""No place is farther away, be it in metres or millimetres: the Earth's radius is 6.4e6 m."""
FARTHEST_PX = 1e5
"""No principal point and no keypoint of an object in view is farther out."""


def between(low: int | float, high: int | float) -> Rule:
    """Make the rule for a number of a closed interval."""

    def rule(value: Any) -> None:
        if not low <= number(value) <= high:
            raise ValueError(f"expected {low:g} to {high:g}, found {value}")

    return rule


def at_least(low: int) -> Rule:
    """Make the rule for a whole number that is not below another."""

    def rule(value: Any) -> None:
        if whole(value) < low:
            raise ValueError(f"expected {low} or more, found {value}")

    return rule


place = between(-FARTHEST, FARTHEST)
pixel = between(-FARTHEST_PX, FARTHEST_PX)


def one_of(values: Iterable[Any], what: str) -> Rule:
    """Make the rule for a value that something else lists."""
    known = frozenset(values)

    def rule(value: Any) -> None:
        if value not in known:
            raise ValueError(f"expected {what}, found {value!r:.60}")

    return rule


def sized(count: int, rule: Rule = number) -> Rule:
    """Make the rule for a list of so many values that all keep a rule."""

    def checked(values: Any) -> None:
        if len(each(rule)(values)) != count:
            raise ValueError(f"expected {count} values, found {len(values)}")

    return checked


def camera_matrix(values: Any) -> None:
    """Rule: the nine numbers of a pinhole camera, row-major."""
    sized(9)(values)
    fx, skew, cx, low, fy, cy, *last = values
    inside = abs(cx) <= FARTHEST_PX and abs(cy) <= FARTHEST_PX
    if not (fx > 0 and fy > 0 and inside and skew == low == 0 and last == [0, 0, 1]):
        raise ValueError(f"expected fx 0 cx 0 fy cy 0 0 1, found {values!s:.120}")


def rotation(values: Any) -> None:
    """Rule: the nine numbers of a rotation, row-major."""
    sized(9)(values)
    matrix = np.array(values, dtype=np.float64).reshape(3, 3)
    with np.errstate(over="ignore", invalid="ignore"):
        skew = np.abs(matrix @ matrix.T - np.eye(3)).max()
    if not (skew <= ROTATION_SKEW and np.linalg.det(matrix) > 0):
        raise ValueError(f"expected a rotation, found {values!s:.120}")


def rigid(values: Any) -> None:
    """Rule: the 16 numbers of a rigid transform, row-major."""
    sized(16)(values)
    sized(3, place)(values[3:12:4])
    rotation([value for row in range(3) for value in values[4 * row : 4 * row + 3]])
    if list(values[12:]) != [0, 0, 0, 1]:
        raise ValueError(f"expected 0 0 0 1 as the last row, found {values[12:]}")
