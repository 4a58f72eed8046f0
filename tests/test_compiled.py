"""Compiled functions are those of today's files, and run where their code cannot be kept."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from numba import njit

from rpl_data.compiled import compiled, forget_older


def test_a_function_is_compiled_where_no_folder_can_be_written() -> None:
    # Of a function without a source file numba has no folder to keep code in, as in a read-only installation.
    names: dict[str, object] = {}
    exec("def share(a, b):\n    return a / b", names)
    with pytest.raises(RuntimeError, match="no locator"):
        njit(names["share"], cache=True)
    assert compiled(names["share"])(1.0, 0.0) == float("inf")


def test_what_was_compiled_before_the_last_change_is_forgotten(tmp_path: Path) -> None:
    kept = tmp_path / "__pycache__"
    kept.mkdir()
    for name in ("draw.fill-3.py311.nbi", "draw.line-9.py311.nbi", "other.fill-3.py311.nbi"):
        (kept / name).touch()
        os.utime(kept / name, (50.0, 50.0))
    os.utime(kept / "draw.line-9.py311.nbi", (150.0, 150.0))
    forget_older(tmp_path / "draw.py", 100.0)
    assert sorted(path.name for path in kept.iterdir()) == ["draw.line-9.py311.nbi", "other.fill-3.py311.nbi"]
