"""Recordings of Luxonis' own programs are refused by name, with what to do; others are left alone."""

from __future__ import annotations

import io
import tarfile
from pathlib import Path

import pytest

from rpl_data.formats.recordings.oak import refuse_oak
from rpl_data.recordings.open import open_recordings
from rpl_data.types import DataError


def write_tar(path: Path, *names: str) -> None:
    with tarfile.open(path, "w") as archive:
        for name in names:
            archive.addfile(tarfile.TarInfo(name), io.BytesIO())


def make_holistic(folder: Path) -> Path:
    write_tar(
        folder / "recording_2026-01-01_10-00-00.tar", "record_config.json", "Camera0.mcap", "Camera0.mp4"
    )
    return folder


def make_unpacked(folder: Path) -> Path:
    for name in ("record_config.json", "CameraCAM_A.mcap", "CameraCAM_A.avi"):
        (folder / name).write_bytes(b"")
    return folder


def make_of_sdk(folder: Path) -> Path:
    (folder / "1-1844301041E6F30E00").mkdir()
    for name in ("calib.json", "color.hevc", "left.hevc", "right.hevc"):
        (folder / "1-1844301041E6F30E00" / name).write_bytes(b"")
    return folder


@pytest.mark.parametrize("make", [make_holistic, make_unpacked, make_of_sdk])
def test_they_are_refused_with_what_to_do(make: object, tmp_path: Path) -> None:
    assert callable(make)
    with pytest.raises(DataError, match=r"an OAK camera without depth.*rpl capture --camera oak"):
        open_recordings(make(tmp_path))


def test_the_archive_itself(tmp_path: Path) -> None:
    (file,) = make_holistic(tmp_path).iterdir()
    with pytest.raises(DataError, match="an OAK camera without depth"):
        open_recordings(file)


def test_others_are_left_alone(tmp_path: Path) -> None:
    write_tar(tmp_path / "a.tar", "scene/rgb/0.png")
    (tmp_path / "b.tar").write_bytes(b"no archive at all" * 100)
    (tmp_path / "calib.json").write_bytes(b"{}")
    refuse_oak(tmp_path)
    with pytest.raises(DataError, match="looks like no format that is known"):
        open_recordings(tmp_path)
