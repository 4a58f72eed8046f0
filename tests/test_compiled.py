"""Compiled functions are those of today's files, and run where their code cannot be kept."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from numba import njit

import rpl_data.compiled
from rpl_data.compiled import compiled, digest_of


def test_a_function_is_compiled_where_no_folder_can_be_written() -> None:
    # Of a function without a source file numba has no folder to keep code in, as in a read-only installation.
    names: dict[str, object] = {}
    exec("def share(a, b):\n    return a / b", names)
    with pytest.raises(RuntimeError, match="no locator"):
        njit(names["share"], cache=True)
    assert compiled(names["share"])(1.0, 0.0) == float("inf")


@pytest.mark.parametrize("users_folder", [False, True])
def test_code_is_kept_until_a_file_of_the_package_changes(
    users_folder: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path / "kept") if users_folder else "")
    source = tmp_path / "twice.py"
    source.write_text("def twice(a):\n    return 2 * a\n")

    def found_compiled() -> bool:
        """Whether another process, which this stands for, finds the function compiled."""
        names: dict[str, object] = {}
        exec(compile(source.read_text(), source, "exec"), names)
        twice = compiled(names["twice"])
        assert twice(2) == 4
        return bool(twice.stats.cache_hits)

    assert [found_compiled(), found_compiled()] == [False, True]
    monkeypatch.setattr(rpl_data.compiled, "digest_of", lambda package: "of changed files")
    assert [found_compiled(), found_compiled()] == [False, True]


def test_a_changed_file_changes_the_digest_whenever_it_was_written(tmp_path: Path) -> None:
    (tmp_path / "room").mkdir()
    constants = tmp_path / "room" / "constants.py"
    constants.write_text("NEAREST = 1\n")
    (tmp_path / ".#open_in_an_editor.py").symlink_to("nowhere")
    before = digest_of(tmp_path)
    constants.write_text("NEAREST = 2\n")
    os.utime(constants, (0, 0))  # as copied with its time
    digest_of.cache_clear()
    assert digest_of(tmp_path) != before
