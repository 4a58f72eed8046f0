"""Files are written whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from rpl_data.files import read_json, read_text, sweep, write_bytes, write_json, write_text, writing
from rpl_data.types import DataError

FullDisk = Callable[[int], AbstractContextManager[None]]


def test_what_is_written_is_read_and_folders_are_made(tmp_path: Path) -> None:
    path = tmp_path / "new/folder/file.json"
    write_json(path, {"a": [1, 2.5, None]})
    assert read_json(path) == {"a": [1, 2.5, None]}
    write_bytes(path, b"\x00")
    assert path.read_bytes() == b"\x00"
    assert [p.name for p in path.parent.iterdir()] == ["file.json"]


def test_full_disk_leaves_the_old_file_and_nothing_else(tmp_path: Path, full_disk: FullDisk) -> None:
    path = tmp_path / "labels.jsonl"
    write_text(path, "old\n")
    with (
        full_disk(4096),
        pytest.raises(DataError, match=r"cannot write .*labels.jsonl.*nothing was changed. Free"),
    ):
        write_text(path, "new\n" * 100_000)
    assert path.read_text() == "old\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    """A folder below a file: refused also for root, whom read-only folders do not stop."""
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match=r"cannot write .*choose another folder"):
        write_text(tmp_path / "file/below/x.txt", "text")
    with pytest.raises(DataError, match="cannot write /proc/"):
        write_text(Path("/proc/x.txt"), "text")


def test_an_error_while_writing_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), writing(tmp_path / "x.txt") as file:
        file.write("half")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_another_programs_error_is_not_taken_for_a_full_disk(tmp_path: Path) -> None:
    """A reader's error inside the block keeps its own message."""
    with pytest.raises(DataError, match="missing.txt does not exist"), writing(tmp_path / "x.txt"):
        read_text(tmp_path / "missing.txt")
    assert list(tmp_path.iterdir()) == []


def test_nan_is_no_json(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "x.json", [float("nan")])
    assert list(tmp_path.iterdir()) == []


def test_reading_names_the_file(tmp_path: Path) -> None:
    (tmp_path / "broken.json").write_text('{"a": ')
    with pytest.raises(DataError, match=r"broken.json is not valid JSON"):
        read_json(tmp_path / "broken.json")
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match=r"cannot read .*binary.txt"):
        read_text(tmp_path / "binary.txt")
    with pytest.raises(DataError, match=f"{tmp_path} is a folder; give a file"):
        read_text(tmp_path)


def test_what_a_killed_build_left_half_written_is_swept_and_nothing_else(tmp_path: Path) -> None:
    litter = [
        "export/.coco.partial-ab12_x9z/train.json", "export/.coco.partial-ab12_x9z-old/train.json",
        "scenes/00/.scene.json.abcdefgh", "scenes/00/cache/depth/.000001.zst.abcdefgh",
        "report/.index.html.12345678", "labels/.00.jsonl.ypdj1_qr",
    ]  # fmt: skip
    kept = [
        "scenes/00/scene.json",
        "export/coco/train.json",
        ".git/config",
        ".hidden",
        "objects/a/.given.ply.abcdefgh",
        "labels/.00.left_out.json.abcdefgh",
    ]
    for name in litter + kept:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x")
    sweep(tmp_path)
    assert {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()} == set(kept)
