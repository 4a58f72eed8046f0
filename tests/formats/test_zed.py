"""What ZED's SDK exports, and its own files, which it alone reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recordings import LENS, depth_image, write_color, write_depth

from rpl_data.images import read_depth_m
from rpl_data.recordings.open import likely_formats, open_scenes
from rpl_data.types import DataError


def make_export(folder: Path) -> None:
    for number in range(540, 546):
        write_color(folder / f"left{number:06d}.png", number - 540)
        write_depth(folder / f"depth{number:06d}.png", number - 540)


def test_an_exported_folder(tmp_path: Path) -> None:
    make_export(tmp_path / "desk")
    (tmp_path / "desk/right000540.png").write_bytes(b"")
    assert likely_formats(tmp_path) == ["zed"] == likely_formats(tmp_path / "desk")
    with pytest.raises(DataError, match=r"does not hold the camera; give `camera: \[fx, fy, cx, cy\]`"):
        open_scenes(tmp_path, "zed")
    (recording,) = open_scenes(tmp_path, "zed", camera=LENS)
    scene = recording.scene
    assert (scene.name, scene.registered, scene.metres_per_unit) == ("desk", True, 0.001)
    assert [frame.index for frame in scene.frames] == list(range(540, 546))
    np.testing.assert_allclose(read_depth_m(scene, scene.frames[3]), depth_image(3) * 0.001, atol=1e-6)
    assert "no timestamps: 30 frames per second assumed" in recording.notes
    (tmp_path / "desk/camera.txt").write_text("50 51 31.5 23.5\nmetres_per_unit 0.0005\n")
    scene = open_scenes(tmp_path, "zed")[0].scene
    assert (scene.intrinsics.fx, scene.intrinsics.cy, scene.metres_per_unit) == (50, 23.5, 0.0005)


def test_the_cameras_own_file_is_told_how_to_be_exported(tmp_path: Path) -> None:
    svo = tmp_path / "HD720_SN1234.svo2"
    svo.write_bytes(b"\x89MCAP0\r\n")  # the second generation lies in an MCAP container
    for path in (svo, tmp_path):
        assert likely_formats(path) == ["zed"]
        with pytest.raises(
            DataError, match=r"can be read by the ZED SDK only; export it .*svo_export.py --mode 4"
        ):
            open_scenes(path, "zed")
    with pytest.raises(DataError, match="has no left<number>.png with depth<number>.png"):
        open_scenes(tmp_path / "none", "zed")


def test_an_export_that_was_cut_off(tmp_path: Path) -> None:
    make_export(tmp_path / "desk")
    (tmp_path / "desk/depth000545.png").unlink()
    left = tmp_path / "desk/left000544.png"
    left.write_bytes(left.read_bytes()[:-20])
    (recording,) = open_scenes(tmp_path, "zed", camera=LENS)
    assert len(recording.scene.frames) == 4
    assert recording.skipped == (
        "1 frame with an unreadable or truncated colour image: 544",
        "1 frame without depth (no such file): 545",
    )
