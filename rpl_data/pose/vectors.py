"""Vectors of three numbers for compiled code; importing this module imports numba.

A pose takes a fraction of a millisecond, most of which numpy would spend on the overhead of small arrays.
"""

from __future__ import annotations

from rpl_data.compiled import compiled

Vector = tuple[float, float, float]


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a: Vector, b: Vector) -> Vector:
    """Cross product ``a x b``."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def difference(a: Vector, b: Vector) -> Vector:
    """``a - b``."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def scaled(a: Vector, factor: float) -> Vector:
    """A vector, times a number."""
    return a[0] * factor, a[1] * factor, a[2] * factor


@compiled
def normalized(a: Vector) -> Vector:
    """A vector of length 1."""
    return scaled(a, 1 / dot(a, a) ** 0.5)
