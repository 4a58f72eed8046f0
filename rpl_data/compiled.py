"""Functions compiled by numba; importing this module imports it, which takes a third of a second."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from inspect import unwrap
from pathlib import Path
from typing import TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile a function at its first call, without bounds checks.

    Real numbers divided by zero are infinite or NaN; complex ones still raise ZeroDivisionError.
    The compiled code is kept for the next process, beside the source or in the user's cache folder, and made
    anew once any file of the package has changed. Where neither folder can be written, as in a read-only
    installation, every process compiles anew: seconds, not a fault.
    """
    plain = unwrap(function)  # the tests check the types of arguments
    try:
        kept = njit(plain, cache=True, error_model="numpy")
        # Numba asks whether the function's own file is the one that was compiled, while compiled code holds
        # functions and constants of other files, too.
        index = kept._cache._cache_file
        index._source_stamp = (index._source_stamp, digest_of(Path(__file__).parent))
    except (RuntimeError, AttributeError):  # numba finds no folder to write to, or keeps code in another way
        kept = njit(plain, error_model="numpy")
    return cast(Function, kept)


@cache
def digest_of(package: Path) -> str:
    """SHA-256 of all source files in a folder."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        with suppress(OSError):  # the lock of an editor, or a file that has just been removed
            digest.update(path.read_bytes())
    return digest.hexdigest()
