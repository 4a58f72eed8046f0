"""Copies from and to object stores: whole files, only what changed, and on from where they were cut off."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fsspec
import pytest

from rpl_data.pipeline.object_store import (
    BATCH,
    MANIFEST,
    check_address,
    copy_name,
    fetch,
    upload,
    url_of,
    without_secrets,
)
from rpl_data.types import DataError


def silent(done: int, total: int) -> None:
    """Progress that nobody looks at."""


def cut_off(done: int, total: int) -> None:
    """The process ends after the first batch."""
    if done >= BATCH:
        raise KeyboardInterrupt


@pytest.fixture
def store() -> Iterator[Any]:
    """A store with a recording of 70 files; it lives in this process."""
    system = fsspec.filesystem("memory")
    for number in range(70):
        system.pipe_file(f"/bucket/rec/00/rgb/{number:03d}.png", bytes([number]) * (number + 1))
    yield system
    system.rm("/bucket", recursive=True)


def test_an_address_is_known_although_a_path_lost_a_slash() -> None:
    assert url_of(Path("s3://bucket/my rec/00")) == "s3://bucket/my rec/00"
    assert url_of(Path("file:///data/rec")) == "file:///data/rec"
    assert url_of("gs://b/c") == "gs://b/c"
    assert [url_of(path) for path in ("/data/rec", "rec", "C:/rec", Path("a:b/c"))] == [None] * 4
    assert copy_name("s3://a/rec") != copy_name("s3://b/rec")
    assert copy_name("s3://a/rec").name == "rec"  # a name by which formats are guessed


def test_only_what_changed_is_copied_here(store: Any, tmp_path: Path) -> None:
    here = tmp_path / "x" / "rec"
    assert fetch("memory://bucket/rec", here, silent) == 70
    assert (here / "00/rgb/069.png").read_bytes() == bytes([69]) * 70
    assert fetch("memory://bucket/rec", here, silent) == 0
    store.pipe_file("/bucket/rec/00/rgb/003.png", b"new!")  # as long as before
    store.rm_file("/bucket/rec/00/rgb/004.png")
    (here / "00/rgb/005.png").write_bytes(b"half")
    assert fetch("memory://bucket/rec", here, silent) == 2
    assert (here / "00/rgb/003.png").read_bytes() == b"new!"
    assert (here / "00/rgb/005.png").read_bytes() == bytes([5]) * 6
    assert not (here / "00/rgb/004.png").exists()


def test_a_copy_that_was_cut_off_goes_on(store: Any, tmp_path: Path) -> None:
    here = tmp_path / "x" / "rec"
    with pytest.raises(KeyboardInterrupt):
        fetch("memory://bucket/rec", here, cut_off)
    assert len(list(here.rglob("*.png"))) == BATCH
    with (tmp_path / "x/copied.jsonl").open("a") as log:
        log.write('\n["00/rgb/069.png", [70')  # half a line, and no file
    assert fetch("memory://bucket/rec", here, silent) == 70 - BATCH
    assert fetch("memory://bucket/rec", here, silent) == 0


def test_one_file_is_copied_and_names_that_lead_out_are_refused(store: Any, tmp_path: Path) -> None:
    assert fetch("memory://bucket/rec/00/rgb/001.png", tmp_path / "y/001.png", silent) == 1
    assert (tmp_path / "y/001.png").read_bytes() == b"\1\1"
    store.store["/bucket/rec/../evil"] = store.store["/bucket/rec/00/rgb/001.png"]
    with pytest.raises(DataError, match="leads out of a folder"):
        fetch("memory://bucket/rec", tmp_path / "z/rec", silent)
    del store.store["/bucket/rec/../evil"]
    with pytest.raises(DataError, match="there is nothing at memory://bucket/other"):
        fetch("memory://bucket/other", tmp_path / "z/other", silent)
    with pytest.raises(DataError, match="nowhere://a cannot be reached: Protocol not known"):
        fetch("nowhere://a", tmp_path / "z/a", silent)


@pytest.mark.parametrize("kind", ["memory", "file"])
def test_an_upload_is_whole_when_its_list_is_there(kind: str, tmp_path: Path) -> None:
    own, record = tmp_path / "coco", tmp_path / "log.jsonl"
    for number in range(70):
        (own / "images").mkdir(parents=True, exist_ok=True)
        (own / f"images/{number}.jpg").write_bytes(bytes([number]))
    url = f"memory://bucket/{tmp_path.name}" if kind == "memory" else f"file://{tmp_path}/there"
    system, root = fsspec.core.url_to_fs(url)
    with pytest.raises(KeyboardInterrupt):
        upload(own, url, record, cut_off)
    assert not system.exists(f"{root}/{MANIFEST}")
    assert upload(own, url, record, silent) == 70 - BATCH
    assert not record.exists()
    assert upload(own, url, record, silent) == 0
    (own / "images/3.jpg").write_bytes(b"x")
    (own / "images/4.jpg").unlink()
    assert upload(own, url, record, silent) == 1
    listed = json.loads(system.cat_file(f"{root}/{MANIFEST}"))
    there = {path[len(root) + 1 :] for path in system.find(root)}
    assert (
        listed.keys()
        == there - {MANIFEST}
        == {path.relative_to(own).as_posix() for path in own.rglob("*.jpg")}
    )
    assert system.cat_file(f"{root}/images/3.jpg") == b"x"


def test_a_recording_may_be_called_partial_and_become_a_file(store: Any, tmp_path: Path) -> None:
    store.pipe_file("/bucket/partial/a/b.txt", b"1")
    here = tmp_path / "x/partial"
    assert fetch("memory://bucket/partial", here, silent) == 1
    assert fetch("memory://bucket/partial", here, silent) == 0
    assert (here / "a/b.txt").read_bytes() == b"1"
    store.rm("/bucket/partial", recursive=True)
    store.pipe_file("/bucket/partial", b"22")
    assert fetch("memory://bucket/partial", here, silent) == 1
    assert here.read_bytes() == b"22"


def test_an_upload_mends_a_list_that_was_cut_off(store: Any, tmp_path: Path) -> None:
    (tmp_path / "coco").mkdir()
    (tmp_path / "coco/train.json").write_text("{}")
    for cut_short in (b'{"train.json": [2,', b"[1]"):
        store.pipe_file(f"/bucket/cups/{MANIFEST}", cut_short)
        upload(tmp_path / "coco", "memory://bucket/cups", tmp_path / "log", silent)
        assert list(json.loads(store.cat_file(f"/bucket/cups/{MANIFEST}"))) == ["train.json"]


def test_no_secret_of_an_address_is_printed() -> None:
    assert without_secrets("no ftp://me:word@host/a b") == "no ftp://...@host/a b"
    assert without_secrets("https://host/a?Signature=1&b=2 or so") == "https://host/a?... or so"
    assert without_secrets("s3://bucket/rec@home") == "s3://bucket/rec@home"
    with pytest.raises(DataError) as raised:
        fetch("nowhere://KEY:SECRET@bucket/a", Path("never"), silent)
    assert "SECRET" not in str(raised.value)


def test_an_address_that_cannot_work_is_refused_without_the_store() -> None:
    check_address("memory://bucket/cups")
    with pytest.raises(DataError, match="'cups' is no address of an object store; expected one such as s3:"):
        check_address("cups")
    with pytest.raises(DataError, match="nowhere://a cannot be reached"):
        check_address("nowhere://a")
