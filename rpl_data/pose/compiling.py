"""Compile functions with numba, and vectors of three numbers for them; importing this module imports numba.

A pose takes a fraction of a millisecond, most of which numpy would spend on the overhead of small arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from inspect import unwrap
from typing import TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])
Vector = tuple[float, float, float]


def compiled(function: Function) -> Function:
    """Compile a function, once for all processes; division by 0 gives infinity or NaN, as in numpy."""
    # Unwrapped, since the tests check the types of arguments.
    return cast(Function, njit(cache=True, error_model="numpy")(unwrap(function)))


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
