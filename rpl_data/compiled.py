"""Functions compiled by numba; importing this module imports it, which takes a third of a second."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from inspect import unwrap
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile a function at its first call, without bounds checks.

    Real numbers divided by zero are infinite or NaN; complex ones still raise ZeroDivisionError.
    The compiled code is kept for the next process, beside the source or in the user's cache folder, and made
    anew once any file of the package has changed. Where neither folder can be written, as in a read-only
    installation or on a full disk, every process compiles anew: seconds, not a fault.
    """
    plain = unwrap(function)  # the tests check the types of arguments
    try:
        kept = njit(plain, cache=True, error_model="numpy")
        _mistrust(kept._cache)
    except (RuntimeError, AttributeError):  # numba finds no folder to write to, or keeps code in another way
        kept = njit(plain, error_model="numpy")
    return cast(Function, kept)


def _mistrust(kept: Any) -> None:
    """Let numba use kept code only where it is surely that of the package as it is, for the types asked for.

    Args:
        kept: what numba keeps of a function, an index of types and a file of code for each of them.
    """
    index, load, save = kept._cache_file, kept.load_overload, kept.save_overload
    # Numba looks whether the function's own file has changed, but the code holds constants of others, too.
    index._source_stamp = (index._source_stamp, digest_of(Path(__file__).parent))

    def load_checked(types: Any, target: Any) -> Any:
        code = load(types, target)
        # Of two processes that save into an empty index at once, one may name there what the other wrote.
        return code if code is not None and code.signature.args == tuple(types) else None

    def save_if_possible(types: Any, code: Any) -> None:
        try:
            save(types, code)
        except OSError:  # a full disk; the index may already name what could not be written
            with suppress(OSError):
                Path(index._index_path).unlink()

    kept.load_overload, kept.save_overload = load_checked, save_if_possible


@cache
def digest_of(package: Path) -> str:
    """SHA-256 of all source files in a folder."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        with suppress(OSError):  # the lock of an editor, or a file that has just been removed
            digest.update(path.read_bytes())
    return digest.hexdigest()
