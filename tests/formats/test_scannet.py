"""ScanNet's .sens files, written by hand."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import color_image, depth_image, poses
from sens_writer import write_sens

from rpl_data.images import read_color, read_depth_m
from rpl_data.recordings.open import likely_formats, open_scenes
from rpl_data.types import DataError, Recording


def read(path: Path, **options: Any) -> Recording:
    (recording,) = open_scenes(path, "scannet", unpack=lambda name: path.parent / "out" / name, **options)
    return recording


@pytest.mark.parametrize("kinds", [(2, 1), (1, 0), (0, 1)])
def test_what_is_written_is_read(kinds: tuple[int, int], tmp_path: Path) -> None:
    path = write_sens(tmp_path / "scene0000_00.sens", kinds=kinds, lost=(1,))
    assert likely_formats(path) == ["scannet"]
    recording = read(path)
    scene = recording.scene
    assert (scene.name, scene.registered, scene.metres_per_unit) == ("scene0000_00", True, 0.001)
    assert recording.skipped == ("1 frame without a valid pose (the tracker was lost there): 1",)
    np.testing.assert_allclose([frame.timestamp_s for frame in scene.frames], [1, 1.066, 1.099])
    for frame in scene.frames:
        np.testing.assert_array_equal(
            read_depth_m(scene, frame), depth_image(frame.index) * np.float32(0.001)
        )
        assert np.abs(read_color(frame).astype(int) - color_image(frame.index)).mean() < 4
    assert recording.trajectory is not None
    np.testing.assert_allclose(recording.trajectory.at(3), poses(4)[3], atol=1e-6)


def test_depth_of_its_own_size(tmp_path: Path) -> None:
    recording = read(write_sens(tmp_path / "a.sens", depth_step=2))
    depth_m = read_depth_m(recording.scene, recording.scene.frames[2])
    stored = depth_image(2) * 0.001
    assert depth_m.shape == (48, 64) and recording.scene.registered
    np.testing.assert_allclose(depth_m[4:40, 4:60], stored[4:40, 4:60], atol=0.0015)


def test_poses_and_times_that_are_not_there(tmp_path: Path) -> None:
    lost = read(write_sens(tmp_path / "a.sens", lost=(0, 1, 2, 3), times=False))
    assert lost.trajectory is None and len(lost.scene.frames) == 4
    assert "no poses in the file: the camera must be tracked" in lost.notes
    assert "no timestamps: 30 frames per second assumed" in lost.notes
    assert read(write_sens(tmp_path / "b.sens", still=True)).trajectory is None


def test_cameras_apart_are_not_called_registered(tmp_path: Path) -> None:
    place = np.eye(4)
    place[0, 3] = 0.02
    recording = read(write_sens(tmp_path / "a.sens", depth_place=place))
    assert not recording.scene.registered
    assert any("extrinsics of their own, which are not used" in note for note in recording.notes)


def test_recordings_that_were_cut_off(tmp_path: Path) -> None:
    content = write_sens(tmp_path / "whole.sens", count=10).read_bytes()
    kept = []
    for percent in (40, 70, 97):
        cut = tmp_path / f"cut{percent}.sens"
        cut.write_bytes(content[: len(content) * percent // 100])
        recording = read(cut)
        kept.append(len(recording.scene.frames))
        assert f"{10 - kept[-1]} of 10 frames: the file was cut off after frame" in recording.skipped[0]
    assert kept == [3, 6, 9]


def test_damaged_files(tmp_path: Path) -> None:
    good = write_sens(tmp_path / "good.sens", count=2).read_bytes()
    for spoilt, words in (
        (b"\5" + good[1:], "is no ScanNet recording"),
        (good[:100], "cut off within its head"),
        (good[:350], "holds no complete frame"),
        (good[:291] + struct.pack("<I", 2**31) + good[295:], "is damaged: images of 2147483648 x 48"),
        (good[:287] + struct.pack("<i", 2) + good[291:], "depth of compression 2 cannot be read"),
    ):
        (tmp_path / "bad.sens").write_bytes(spoilt)
        with pytest.raises(DataError, match=words):
            read(tmp_path / "bad.sens")
    bomb = good.replace(zlib.compress(depth_image(0).astype("<u2").tobytes())[:20], bytes(20))
    (tmp_path / "bad.sens").write_bytes(bomb)
    assert read(tmp_path / "bad.sens").skipped == ("1 frame with damaged data in the file: 0",)
