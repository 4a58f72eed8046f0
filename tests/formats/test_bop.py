"""BOP's scenes: read as recordings, the objects' poses kept apart as truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from recordings import CAMERA, LENS, cut, poses, write_color, write_depth

from rpl_data.formats.recordings.bop import read_bop, write_scene_camera, write_scene_gt
from rpl_data.geometry import from_rotvec, invert
from rpl_data.images import read_depth_m
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError

IDS = [2, 9, 10, 100]
"""As text, 10 and 100 come before 2."""

SCENE_FROM_MUG = from_rotvec(np.array([0.3, -0.2, 0.5]), np.array([0.1, -0.05, 0.8]))


def make_scene(folder: Path, *, suffix: str = "png", unit_m: float = 0.0001, posed: bool = True) -> Path:
    cameras = dict(zip(IDS, poses(len(IDS)), strict=True))
    for number, i in enumerate(IDS):
        write_color(folder / f"rgb/{i:06d}.{suffix}", number)
        write_depth(folder / f"depth/{i:06d}.png", number, unit=7000)
    write_scene_camera(folder, CAMERA, unit_m, {i: pose if posed else None for i, pose in cameras.items()})
    write_scene_gt(folder, {i: [(5, invert(pose) @ SCENE_FROM_MUG)] for i, pose in cameras.items()})
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return make_scene(tmp_path / "ycbv/test/000048")


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_what_is_written_is_read(tmp_path: Path, suffix: str) -> None:
    (recording,) = read_bop(make_scene(tmp_path / "000048", suffix=suffix))
    scene = recording.scene
    assert (scene.name, scene.intrinsics, scene.registered) == ("000048", CAMERA, True)
    assert scene.metres_per_unit == pytest.approx(0.0001)
    assert [frame.index for frame in scene.frames] == IDS
    assert recording.skipped == () and len(recording.notes) == 1
    assert "no timestamps" in recording.notes[0]
    assert recording.trajectory is not None
    np.testing.assert_allclose(recording.trajectory.scene_from_camera, poses(4), atol=1e-12)
    assert read_depth_m(scene, scene.frames[1])[0, 0] == pytest.approx(0.7001)


def test_the_files_are_as_the_format_says(folder: Path) -> None:
    """Worked by hand: millimetres, row-major, camera_from_scene."""
    entry = json.loads((folder / "scene_camera.json").read_text())["9"]
    assert entry["cam_K"] == [50.0, 0, 31.5, 0, 51.0, 23.5, 0, 0, 1]
    assert entry["depth_scale"] == pytest.approx(0.1)
    c, s = np.cos(0.1), np.sin(0.1)  # the camera turned by 0.1 about y and stands at x = 0.1 m
    assert entry["cam_R_w2c"] == pytest.approx([c, 0, -s, 0, 1, 0, s, 0, c])
    assert entry["cam_t_w2c"] == pytest.approx([-100 * c, 0, -100 * s])


def test_poses_of_objects_are_truth_and_stand_still(folder: Path) -> None:
    (recording,) = read_bop(folder)
    assert recording.trajectory is not None
    assert list(recording.true_poses) == ["obj_000005"]
    for index, camera_from_object in recording.true_poses["obj_000005"].items():
        scene_from_object = recording.trajectory.at(index) @ camera_from_object
        np.testing.assert_allclose(scene_from_object, SCENE_FROM_MUG, atol=1e-12)


def test_inverted_camera_poses_are_noticed(folder: Path) -> None:
    write_scene_camera(folder, CAMERA, 0.0001, dict(zip(IDS, invert(poses(4)), strict=True)))
    (recording,) = read_bop(folder)
    assert "obj_000005 moves by" in recording.notes[-1]
    assert "set `mend: {inverted_poses: true}`" in recording.notes[-1]


def test_objects_that_nothing_tells_apart_are_no_truth(folder: Path) -> None:
    pose = np.eye(4)
    write_scene_gt(folder, {2: [(5, pose), (7, pose), (7, pose)], 9: [(7, pose)]})
    (recording,) = read_bop(folder)
    assert {name: list(of_frame) for name, of_frame in recording.true_poses.items()} == {
        "obj_000005": [2], "obj_000007": [9],
    }  # fmt: skip
    assert any("1 frame with an object more than once" in note for note in recording.notes)


def test_without_poses_and_without_truth(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "000001", posed=False)
    (scene / "scene_gt.json").unlink()
    (recording,) = read_bop(scene)
    assert recording.trajectory is None and recording.true_poses == {}
    assert "must be tracked" in recording.notes[0]


def test_a_split_a_dataset_and_the_wrong_format(folder: Path) -> None:
    make_scene(folder.parent / "000050")
    split = folder.parent
    assert [found.scene.name for found in read_bop(split)] == ["000048", "000050"]
    assert [found.scene.name for found in open_scenes(split, "bop", names=["000050"])] == ["000050"]
    with pytest.raises(DataError, match="its splits are test: give one of them"):
        read_bop(split.parent)
    with pytest.raises(DataError, match="It looks like `format: bop`"):
        open_scenes(split, "tum")


def test_what_is_given_wins(folder: Path) -> None:
    (recording,) = read_bop(folder, camera=(*LENS[:2], 30.0, 24.0), metres_per_unit=0.0002)
    assert (recording.scene.intrinsics.cx, recording.scene.metres_per_unit) == (30.0, 0.0002)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("cam_K", [51.0, 0, 31.5, 0, 51.0, 23.5, 0, 0, 1], "cam_K changes between images 2 and 10"),
        ("cam_K", [51.0], "expected 9 finite numbers in cam_K"),
        ("depth_scale", 1.0, r"depth_scale changes within the scene"),
        ("cam_t_w2c", [1.0, "x", 2], "has no numbers cam_t_w2c"),
    ],
)
def test_broken_entries_are_refused(folder: Path, key: str, value: object, message: str) -> None:
    path = folder / "scene_camera.json"
    content = json.loads(path.read_text())
    content["10"][key] = value
    path.write_text(json.dumps(content))
    with pytest.raises(DataError, match=message):
        read_bop(folder)


def test_broken_files_and_frames(folder: Path) -> None:
    (folder / "depth/000009.png").write_bytes(b"")
    cut(folder / "rgb/000100.png")
    (recording,) = read_bop(folder)
    assert [frame.index for frame in recording.scene.frames] == [2, 10]
    assert set(recording.skipped) == {
        "1 frame with an unreadable or truncated depth image: 9",
        "1 frame with an unreadable or truncated colour image: 100",
    }
    assert list(recording.true_poses["obj_000005"]) == [2, 10]
    cut(folder / "scene_camera.json")
    assert "after 3 images; the rest of it is lost" in read_bop(folder)[0].skipped[0]
    (folder / "scene_camera.json").write_text('{"2": {"cam_K"')
    with pytest.raises(DataError, match=r"scene_camera.json is not valid JSON"):
        read_bop(folder)
    (folder / "scene_camera.json").write_text('{"one": {}}')
    with pytest.raises(DataError, match="expected .*image id"):
        read_bop(folder)
