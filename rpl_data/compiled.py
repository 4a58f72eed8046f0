"""Functions compiled by numba; importing this module imports it, which takes a third of a second."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from inspect import unwrap
from pathlib import Path
from typing import TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile a function at its first call, without bounds checks.

    Real numbers divided by zero are infinite or NaN; complex ones still raise ZeroDivisionError.
    The compiled code is kept for the next process, beside the source or in the user's cache folder. Where
    neither can be written, as in a read-only installation, every process compiles anew: seconds, not a fault.
    """
    plain = unwrap(function)  # the tests check the types of arguments
    forget_older(Path(plain.__code__.co_filename), newest_source_s())
    try:
        kept = njit(plain, cache=True, error_model="numpy")
    except RuntimeError:  # numba finds no folder to write to
        kept = njit(plain, error_model="numpy")
    return cast(Function, kept)


@cache
def newest_source_s() -> float:
    """When the newest file of the package was written."""
    return max(path.stat().st_mtime for path in Path(__file__).parent.rglob("*.py"))


@cache
def forget_older(source: Path, newest_s: float) -> None:
    """Remove what was compiled from a file before any file of the package was changed.

    Numba looks at the function's own file only, while compiled code holds functions and constants of others.
    """
    for index in (source.parent / "__pycache__").glob(f"{source.stem}.*.nbi"):
        try:
            if index.stat().st_mtime < newest_s:
                index.unlink()
        except OSError:  # another process was faster, or the folder is not ours to write
            continue
