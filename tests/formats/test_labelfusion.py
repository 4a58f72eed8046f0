"""LabelFusion's log directories, made by hand."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from recordings import LENS, cut, poses, write_color, write_depth

from rpl_data.formats.recordings.labelfusion import read_labelfusion
from rpl_data.formats.recordings.pose_lines import write_pose_lines
from rpl_data.geometry import from_rotvec, invert, to_quaternion_xyzw
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError

SCENE_FROM_DRILL = from_rotvec(np.array([0.3, -0.2, 0.5]), np.array([0.1, -0.05, 0.8]))
FIRST_US = 1_500_000_000_123_456


def time_us(number: int) -> int:
    return FIRST_US + number * 33_333


def write_poses_yaml(path: Path, camera_from_object: np.ndarray) -> None:
    """The scalar part of the quaternion comes first."""
    wxyz = np.roll(to_quaternion_xyzw(camera_from_object), 1)
    pose = [camera_from_object[:3, 3].tolist(), wxyz.tolist()]
    path.write_text(yaml.safe_dump({"drill": {"label": 1, "num_pixels": 900, "pose": pose}}))


def make_log(folder: Path, count: int = 4) -> Path:
    images = folder / "images"
    for n in range(1, count + 1):
        write_color(images / f"{n:010d}_rgb.png", n)
        write_color(images / f"{n:010d}_color_labels.png", n)
        write_depth(images / f"{n:010d}_depth.png", n)
        (images / f"{n:010d}_utime.txt").write_text(str(time_us(n)))
        write_poses_yaml(images / f"{n:010d}_poses.yaml", invert(poses(count)[n - 1]) @ SCENE_FROM_DRILL)
    write_pose_lines(
        folder / "posegraph.posegraph", [time_us(n) * 1e-6 for n in range(1, count + 1)], poses(count)
    )
    return folder


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return make_log(tmp_path / "logs/2017-06-01-01")


def test_a_log(log: Path) -> None:
    (recording,) = read_labelfusion(log, camera=LENS)
    scene = recording.scene
    assert (scene.name, scene.metres_per_unit, scene.registered) == ("2017-06-01-01", 0.001, True)
    assert [frame.index for frame in scene.frames] == [1, 2, 3, 4]
    assert [frame.color.name for frame in scene.frames][0] == "0000000001_rgb.png"
    assert scene.frames[0].timestamp_s == pytest.approx(time_us(1) * 1e-6, abs=1e-6)
    assert recording.skipped == () and recording.notes == ()
    assert recording.trajectory is not None
    np.testing.assert_allclose(recording.trajectory.scene_from_camera, poses(4), atol=1e-8)


def test_poses_of_objects_are_truth_and_stand_still(log: Path) -> None:
    (log / "images/0000000003_poses.yaml").write_text("")  # no object is seen
    (recording,) = read_labelfusion(log, camera=LENS)
    assert recording.trajectory is not None
    assert list(recording.true_poses["drill"]) == [1, 2, 4]
    for index, camera_from_object in recording.true_poses["drill"].items():
        np.testing.assert_allclose(
            recording.trajectory.at(index) @ camera_from_object, SCENE_FROM_DRILL, atol=1e-7
        )


def test_the_smoothed_posegraph_is_preferred_and_matched_by_time(log: Path) -> None:
    """ElasticFusion never processes the last frame."""
    smoothed = poses(4)[1:]
    write_pose_lines(log / "posegraph_smoothed.posegraph", [time_us(n) * 1e-6 for n in (1, 2, 3)], smoothed)
    (recording,) = read_labelfusion(log, camera=LENS)
    assert recording.trajectory is not None
    np.testing.assert_allclose(recording.trajectory.scene_from_camera, smoothed, atol=1e-8)
    assert recording.skipped == ("1 frame without a pose in posegraph_smoothed.posegraph at their time: 4",)


def test_the_camera_is_labelfusions_for_its_own_images_only(log: Path) -> None:
    with pytest.raises(DataError, match="is for 640 x 480 images, these are 64 x 48; give `camera:"):
        read_labelfusion(log)
    for path in (log / "images").glob("*_rgb.png"):
        cv2.imwrite(str(path), np.full((480, 640, 3), 90, np.uint8))
        cv2.imwrite(str(path).replace("rgb", "depth"), np.full((480, 640), 700, np.uint16))
    (recording,) = open_scenes(log.parent, "labelfusion")
    lens = recording.scene.intrinsics
    assert (lens.fx, lens.fy, lens.cx, lens.cy) == (528, 528, 320, 240)
    assert recording.notes == ("no camera stored: LabelFusion's own f = 528 px assumed",)


def test_what_is_missing_is_named(log: Path) -> None:
    images = log / "images"
    (images / "0000000001_utime.txt").write_text("")
    cut(images / "0000000002_rgb.png")
    (images / "0000000003_depth.png").write_bytes(b"")
    (recording,) = read_labelfusion(log, camera=LENS)
    assert [frame.index for frame in recording.scene.frames] == [4]
    assert recording.skipped == (
        "1 frame without a readable utime.txt: 1",
        "1 frame with an unreadable or truncated colour image: 2",
        "1 frame with an unreadable or truncated depth image: 3",
    )
    (log / "posegraph.posegraph").unlink()
    (recording,) = read_labelfusion(log, camera=LENS)
    assert recording.trajectory is None and "must be tracked" in recording.notes[0]


def test_what_cannot_be_read_says_what_to_do(log: Path) -> None:
    with pytest.raises(DataError, match="It looks like `format: labelfusion`"):
        open_scenes(log, "rpl")
    (log / "images/0000000001_poses.yaml").write_text("drill: {pose: [[0, 0, 1]]}")
    with pytest.raises(DataError, match=r"0000000001_poses.yaml: drill should have pose"):
        read_labelfusion(log, camera=LENS)
    for path in (log / "images").glob("*_depth.png"):
        path.unlink()
    with pytest.raises(DataError, match="no depth images; extract them again with depth"):
        read_labelfusion(log, camera=LENS)
    for path in (log / "images").iterdir():
        path.unlink()
    (log / "original_log.lcmlog").write_bytes(b"")
    with pytest.raises(DataError, match="extract them from the log with LabelFusion"):
        read_labelfusion(log, camera=LENS)
