"""Compiled functions are those of today's files, and run where their code cannot be kept."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest
from numba import njit

import rpl_data.compiled
from rpl_data.compiled import compiled, digest_of


def another_process(folder: Path) -> Any:
    """What stands for another process that compiles the function `twice` of a file in that folder."""
    source = folder / "twice.py"
    source.write_text("def twice(a):\n    return 2 * a\n")
    names: dict[str, object] = {"__builtins__": {}}  # numba keeps them all, those of other tests included
    exec(compile(source.read_text(), source, "exec"), names)
    return compiled(names["twice"])


def was_kept(folder: Path) -> bool:
    """Whether another process finds the function compiled."""
    twice = another_process(folder)
    assert twice(2) == 4
    return bool(twice.stats.cache_hits)


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
    assert [was_kept(tmp_path), was_kept(tmp_path)] == [False, True]
    monkeypatch.setattr(rpl_data.compiled, "digest_of", lambda package: "of changed files")
    assert [was_kept(tmp_path), was_kept(tmp_path)] == [False, True]


def test_code_that_another_process_kept_for_other_types_is_not_run(tmp_path: Path) -> None:
    twice = another_process(tmp_path)
    assert (twice(2), twice(2.5)) == (4, 5)
    kept = Path(twice.stats.cache_path)
    of_int, of_float = sorted(kept.glob("twice.*.nbc"))
    of_int.write_bytes(of_float.read_bytes())  # as when both saved at once, and the index names one only
    twice = another_process(tmp_path)
    assert type(twice(2)) is int


def test_code_for_which_the_disk_has_no_room_is_run_and_not_kept(
    tmp_path: Path, full_disk: Callable[[int], AbstractContextManager[None]]
) -> None:
    with full_disk(2000):  # there is room for the index
        assert not was_kept(tmp_path)
    assert not list(tmp_path.rglob("*.nb[ic]"))


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
