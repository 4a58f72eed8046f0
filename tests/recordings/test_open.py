"""Recordings are opened without saying how they are stored, where that can be seen."""

from __future__ import annotations

from pathlib import Path

import pytest

from rpl_data.recordings.open import open_recordings
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace


def test_a_tree_and_one_scene_of_it_are_recognised(tiny_workspace: Workspace) -> None:
    tree = tiny_workspace.recording
    assert [one.scene.name for one in open_recordings(str(tree))] == ["00", "01", "02"]
    (one,) = open_recordings(tree / "01", camera=[300.0, 300.0, 160.0, 120.0], registered=False)
    assert (one.scene.name, len(one.scene.frames), one.scene.registered) == ("01", 6, False)
    assert one.scene.intrinsics.fx == 300
    assert one.trajectory is not None and one.trajectory.scene_from_camera.shape == (6, 4, 4)


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        DataError,
        match="looks like no format that is known: .*, or give `format` \\(--format\\), one of bop, ",
    ):
        open_recordings(tmp_path)
    with pytest.raises(DataError, match="there is no recording .*nowhere"):
        open_recordings(str(tmp_path / "nowhere"))


def test_what_looks_like_two_formats_is_not_guessed(tmp_path: Path) -> None:
    (tmp_path / "a.klg").write_bytes(b"")
    (tmp_path / "camera.txt").write_text("")
    (tmp_path / "00").mkdir()
    (tmp_path / "00/associations.txt").write_text("")
    with pytest.raises(DataError, match="looks like rpl and like klg; give `format`"):
        open_recordings(tmp_path)


def test_a_format_in_one_file_needs_a_folder_for_its_images(tmp_path: Path) -> None:
    (tmp_path / "a.klg").write_bytes(b"")
    with pytest.raises(DataError, match="say where to: `unpack`"):
        open_recordings(tmp_path / "a.klg")
