"""Compiled functions run where their code cannot be kept for the next process."""

from __future__ import annotations

import pytest
from numba import njit

from rpl_data.compiled import compiled


def test_a_function_is_compiled_where_no_folder_can_be_written() -> None:
    # Of a function without a source file numba has no folder to keep code in, as in a read-only installation.
    names: dict[str, object] = {}
    exec("def share(a, b):\n    return a / b", names)
    with pytest.raises(RuntimeError, match="no locator"):
        njit(names["share"], cache=True)
    assert compiled(names["share"])(1.0, 0.0) == float("inf")
