"""The reader of numbered frames (7-Scenes, 3DMatch, tsdf-fusion-python)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recordings import CAMERA, LENS, cut, poses, write_color, write_depth

from rpl_data.formats.recordings.frames import read_frames, write_frame_camera, write_frame_pose
from rpl_data.images import read_depth_m
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError

FIRST = 540


def make_frames(folder: Path, count: int = 5, *, suffix: str = "jpg") -> Path:
    for i in range(count):
        write_color(folder / f"frame-{FIRST + i:06d}.color.{suffix}", i)
        write_depth(folder / f"frame-{FIRST + i:06d}.depth.png", i)
        write_frame_pose(folder, FIRST + i, poses(count)[i])
    write_frame_camera(folder, CAMERA)
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return make_frames(tmp_path / "kitchen")


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_what_is_written_is_read(tmp_path: Path, suffix: str) -> None:
    (recording,) = read_frames(make_frames(tmp_path / "kitchen", suffix=suffix))
    scene = recording.scene
    assert (scene.name, scene.intrinsics, scene.metres_per_unit) == ("kitchen", CAMERA, 0.001)
    assert [frame.index for frame in scene.frames] == [540, 541, 542, 543, 544]
    assert recording.skipped == ()
    assert recording.trajectory is not None
    np.testing.assert_allclose(recording.trajectory.at(542), poses(5)[2])
    assert read_depth_m(scene, scene.frames[3])[0, 0] == pytest.approx(0.703)


def test_what_the_layout_does_not_say_is_said(folder: Path) -> None:
    (recording,) = read_frames(folder)
    assert not recording.scene.registered
    notes = "\n".join(recording.notes)
    assert "30 frames per second assumed" in notes
    assert "set `registered: true`" in notes
    assert "metres_per_unit not given, assumed 0.001" in notes
    assert open_scenes(folder, "frames", registered=True)[0].scene.registered


def test_two_values_mean_no_depth(folder: Path) -> None:
    import cv2

    write = np.full((48, 64), 900, np.uint16)
    write[5, 6], write[5, 7] = 65535, 0
    cv2.imwrite(str(folder / "frame-000540.depth.png"), write)
    (recording,) = read_frames(folder)
    depth_m = read_depth_m(recording.scene, recording.scene.frames[0])
    assert depth_m[5, 6] == depth_m[5, 7] == 0
    assert depth_m[5, 8] == pytest.approx(0.9)


@pytest.mark.parametrize(
    "text",
    ["nan " * 16, "-1.#IND " * 16, "0 " * 16, "1 0 0 0 0 1 0", "-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1", ""],
    ids=["nan", "windows", "zeros", "cut", "mirror", "empty"],
)
def test_frames_where_the_tracker_was_lost_are_left_out(folder: Path, text: str) -> None:
    (folder / "frame-000542.pose.txt").write_text(text)
    (folder / "frame-000543.pose.txt").unlink()
    (recording,) = read_frames(folder)
    assert [frame.index for frame in recording.scene.frames] == [540, 541, 544]
    assert recording.trajectory is not None and recording.trajectory.frames.tolist() == [540, 541, 544]
    assert recording.skipped == ("2 frames without a valid pose.txt (the tracker was lost there): 542, 543",)


def test_without_any_pose_the_camera_must_be_tracked(folder: Path) -> None:
    for path in folder.glob("*.pose.txt"):
        path.unlink()
    (recording,) = read_frames(folder)
    assert recording.trajectory is None
    assert "must be tracked" in recording.notes[0]


def test_broken_images_are_named_and_left_out(folder: Path) -> None:
    cut(folder / "frame-000540.color.jpg")
    (folder / "frame-000541.depth.png").write_bytes(b"")
    (folder / "frame-000543.depth.png").unlink()
    (recording,) = read_frames(folder)
    assert [frame.index for frame in recording.scene.frames] == [542, 544]
    assert set(recording.skipped) == {
        "1 frame with an unreadable or truncated colour image: 540",
        "1 frame with an unreadable or truncated depth image: 541",
        "1 frame without depth (no such file): 543",
    }


def test_sequences_share_a_camera_file(tmp_path: Path) -> None:
    """As in 7-Scenes, whose sequences are folders side by side."""
    for name in ("seq-02", "seq-01"):
        make_frames(tmp_path / name)
        (tmp_path / name / "camera-intrinsics.txt").rename(tmp_path / "camera-intrinsics.txt")
    assert [r.scene.name for r in read_frames(tmp_path)] == ["seq-01", "seq-02"]
    assert [r.scene.name for r in read_frames(tmp_path, names=["seq-02"])] == ["seq-02"]
    with pytest.raises(DataError, match="has no scene seq-03; it has seq-01, seq-02"):
        read_frames(tmp_path, names=["seq-03"])


def test_a_camera_can_be_given(folder: Path) -> None:
    (folder / "camera-intrinsics.txt").unlink()
    with pytest.raises(DataError, match=r"has no camera-intrinsics.txt .* give `camera: \[fx, fy, cx, cy\]`"):
        read_frames(folder)
    (recording,) = read_frames(folder, camera=(*LENS, 0.1, 0.0, 0.0, 0.0))
    assert recording.scene.intrinsics.distortion == (0.1, 0.0, 0.0, 0.0)
    with pytest.raises(DataError, match=r"a camera is fx fy cx cy .* found 50 51 31.5"):
        read_frames(folder, camera=LENS[:3])


def test_wrong_folders_and_files_are_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="has no frame-<number>.color.jpg"):
        read_frames(tmp_path / "nowhere")
    with pytest.raises(DataError, match=r"holds no recording.*It looks like `format: frames`"):
        open_scenes(folder, "rpl")
    (folder / "camera-intrinsics.txt").write_text("50 0 31.5 0 51 23.5")
    with pytest.raises(DataError, match="or the 3x3 matrix K; found '50 0 31.5 0 51 23.5'"):
        read_frames(folder)


def test_the_wrong_format_is_told_by_its_name(folder: Path) -> None:
    with pytest.raises(DataError, match=r"rgb.txt and depth.txt.*It looks like `format: frames`"):
        open_scenes(folder, "tum")


def test_the_kitchen(real_data: Path) -> None:
    (recording,) = read_frames(real_data / "kitchen")
    assert len(recording.scene.frames) == 260
    assert recording.scene.frames[0].index == 540
    assert recording.skipped == ()
    assert recording.trajectory is not None and len(recording.trajectory.frames) == 260
