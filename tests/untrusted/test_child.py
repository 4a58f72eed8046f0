"""Work in a process of its own: its answer, its errors, and its death."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from rpl_data.files import decoding, read_bytes, read_json, read_text
from rpl_data.meshes import load_mesh
from rpl_data.types import DataError
from rpl_data.untrusted.child import in_child

FILE = Path("a.off")


def test_the_answer_and_the_refusal_come_back() -> None:
    assert in_child(divmod, 17, 5, file=FILE) == (3, 2)
    with pytest.raises(DataError, match="there is no mesh nowhere.ply"):
        in_child(load_mesh, Path("nowhere.ply"), file=FILE)


def test_death_by_a_signal_a_limit_or_a_fault_is_one_line() -> None:
    with pytest.raises(DataError, match=r"a\.off is damaged: reading it was ended by signal SIGSEGV"):
        in_child(signal.raise_signal, signal.SIGSEGV, file=FILE)
    with pytest.raises(DataError, match="SIGXCPU|SIGKILL"):
        in_child(pow, 3, 10**9, file=FILE, limit_s=1)
    with pytest.raises(DataError, match="MemoryError"):
        in_child(bytes, 10**12, file=FILE)
    with pytest.raises(DataError, match="ZeroDivisionError"):
        in_child(divmod, 1, 0, file=FILE)


@pytest.mark.parametrize("name", ["mesh.off", "mesh.obj", "mesh.stl"])
def test_a_file_that_is_no_mesh_ends_nothing(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"OFF\n1000000000 5 0\n0 0 0\n" + bytes(range(256)))
    with pytest.raises(DataError, match=name):
        load_mesh(tmp_path / name)


def test_a_pipe_is_refused_before_anybody_waits_for_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.ply")
    for read in (read_text, read_bytes, read_json):
        with pytest.raises(DataError, match="is a pipe, a device or a socket"):
            read(tmp_path / "pipe.ply")
    with pytest.raises(DataError, match="is a pipe, a device or a socket"):
        read_bytes(Path("/dev/zero"))
    with pytest.raises(DataError, match="there is no mesh"):
        load_mesh(tmp_path / "pipe.ply")


@pytest.mark.parametrize("text", ["[" * 100_000, "9" * 5000, "{", '{"a": nan'])
def test_json_that_cannot_be_read_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(DataError, match=r"a\.json is not valid JSON"):
        read_json(tmp_path / "a.json")


def test_any_fault_of_decoding_names_the_file_and_what_to_do() -> None:
    for fault in (
        KeyError("points"),
        IndexError("list index"),
        ValueError("no number"),
        OverflowError("big"),
    ):
        expected = r"a\.off .*(lacks 'points'|damaged).*; make it again"
        with pytest.raises(DataError, match=expected), decoding(FILE, "make it again"):
            raise fault
