"""Functions compiled by numba; importing this module imports it, which takes a third of a second."""

from __future__ import annotations

from collections.abc import Callable
from inspect import unwrap
from typing import TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile a function at its first call, without bounds checks.

    Real numbers divided by zero are infinite or NaN; complex ones still raise ZeroDivisionError.
    The compiled code is kept for the next process, beside the source or in the user's cache folder. Where
    neither can be written, as in a read-only installation, every process compiles anew: seconds, not a fault.
    A change to a function or constant of another file goes unnoticed; see CONTRIBUTING.md.
    """
    plain = unwrap(function)  # the tests check the types of arguments
    try:
        kept = njit(plain, cache=True, error_model="numpy")
    except RuntimeError:  # numba finds no folder to write to
        kept = njit(plain, error_model="numpy")
    return cast(Function, kept)
