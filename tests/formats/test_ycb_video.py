"""YCB-Video's own layout, made by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import CAMERA, LENS, cut, poses, write_color, write_depth
from scipy.io import savemat

from rpl_data.formats.recordings.ycb_video import CLASSES, read_ycb_video
from rpl_data.geometry import from_rotvec, invert
from rpl_data.images import read_depth_m
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError

SCENE_FROM = {
    5: from_rotvec(np.array([0.3, -0.2, 0.5]), np.array([0.1, -0.05, 0.8])),
    15: from_rotvec(np.array([0, 0.4, 0]), np.array([-0.1, 0.05, 0.7])),
}
MUSTARD, DRILL = "006_mustard_bottle", "035_power_drill"


def write_meta(
    path: Path, scene_from_camera: np.ndarray, classes: tuple[int, ...] = (5, 15), **more: Any
) -> None:
    """As MATLAB keeps it: doubles, columns, rows of matrices without the last."""
    camera_from_scene = invert(scene_from_camera)
    matrices = [(camera_from_scene @ SCENE_FROM[number])[:3] for number in classes]
    content = {
        "cls_indexes": np.array(classes, np.uint8)[:, None],
        "factor_depth": np.array([[10000]], np.uint16),
        "intrinsic_matrix": CAMERA.matrix,
        "poses": np.squeeze(np.stack(matrices, axis=2)),
        "rotation_translation_matrix": camera_from_scene[:3],
        "vertmap": np.zeros((2, 2, 3), np.float32),
    }
    savemat(path, content | more, oned_as="column")


def make_sequence(folder: Path, count: int = 4) -> Path:
    for n in range(1, count + 1):
        write_color(folder / f"{n:06d}-color.png", n)
        write_depth(folder / f"{n:06d}-depth.png", n, unit=7000)
        write_color(folder / f"{n:06d}-label.png", 0)
        write_meta(folder / f"{n:06d}-meta.mat", poses(count)[n - 1])
    return folder


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    make_sequence(tmp_path / "YCB_Video_Dataset/data/0048")
    make_sequence(tmp_path / "YCB_Video_Dataset/data/0060", 2)
    return tmp_path / "YCB_Video_Dataset"


def test_a_sequence(dataset: Path) -> None:
    recording, other = read_ycb_video(dataset)
    scene = recording.scene
    assert (scene.name, scene.intrinsics, scene.metres_per_unit) == ("0048", CAMERA, 0.0001)
    assert [frame.index for frame in scene.frames] == [1, 2, 3, 4]
    assert recording.skipped == () and len(recording.notes) == 1
    assert recording.trajectory is not None
    np.testing.assert_allclose(recording.trajectory.scene_from_camera, poses(4), atol=1e-12)
    assert read_depth_m(scene, scene.frames[2])[0, 0] == pytest.approx(0.7003)
    assert len(other.scene.frames) == 2


def test_poses_of_objects_are_truth_and_stand_still(dataset: Path) -> None:
    (recording,) = read_ycb_video(dataset, names=["0048"])
    assert recording.trajectory is not None
    assert list(recording.true_poses) == [MUSTARD, DRILL]
    for number, name in ((5, MUSTARD), (15, DRILL)):
        assert CLASSES[number - 1] == name
        for index, camera_from_object in recording.true_poses[name].items():
            at = recording.trajectory.at(index) @ camera_from_object
            np.testing.assert_allclose(at, SCENE_FROM[number], atol=1e-12)


def test_one_object_is_stored_without_its_axis(dataset: Path) -> None:
    """MATLAB drops the last axis of 3 x 4 x 1."""
    write_meta(dataset / "data/0060/000001-meta.mat", poses(2)[0], (5,))
    (recording,) = read_ycb_video(dataset, names=["0060"])
    assert {name: list(of_frame) for name, of_frame in recording.true_poses.items()} == {
        MUSTARD: [1, 2], DRILL: [2],
    }  # fmt: skip


def test_the_camera_and_the_unit_are_the_sequences(dataset: Path) -> None:
    """Sequences 60-91 are from another camera."""
    for n in (1, 2):
        other = np.array([[60.0, 0, 30.0], [0, 61.0, 26.0], [0, 0, 1]])
        write_meta(
            dataset / f"data/0060/{n:06d}-meta.mat",
            poses(2)[n - 1],
            intrinsic_matrix=other,
            factor_depth=5000,
        )
    first, second = (found.scene for found in open_scenes(dataset, "ycb_video"))
    assert (first.intrinsics.fx, second.intrinsics.fx, second.intrinsics.cy) == (50.0, 60.0, 26.0)
    assert (first.metres_per_unit, second.metres_per_unit) == (0.0001, 0.0002)
    given = read_ycb_video(dataset / "data/0060", camera=LENS, metres_per_unit=0.0001)[0].scene
    assert (given.intrinsics.fx, given.metres_per_unit) == (50.0, 0.0001)


def test_names_of_classes_are_the_datasets(dataset: Path) -> None:
    (dataset / "image_sets").mkdir()
    (dataset / "image_sets/classes.txt").write_text("\n".join(f"thing_{n}" for n in range(1, 22)) + "\n")
    assert list(read_ycb_video(dataset / "data/0048")[0].true_poses) == ["thing_15", "thing_5"]


def test_sequences_of_jpegs_and_without_poses(tmp_path: Path) -> None:
    folder = make_sequence(tmp_path / "0001")
    for n in range(1, 5):
        (folder / f"{n:06d}-color.png").unlink()
        write_color(folder / f"{n:06d}-color.jpg", n)
    (recording,) = read_ycb_video(folder)
    assert len(recording.scene.frames) == 4
    from scipy.io import loadmat

    for path in folder.glob("*.mat"):
        kept = {k: v for k, v in loadmat(path).items() if k[0] != "_" and k != "rotation_translation_matrix"}
        savemat(path, kept)
    (recording,) = read_ycb_video(folder)
    assert recording.trajectory is None and "must be tracked" in recording.notes[0]


def test_what_is_broken_is_named_and_left_out(dataset: Path) -> None:
    folder = dataset / "data/0048"
    (folder / "000001-depth.png").write_bytes(b"")
    cut(folder / "000002-meta.mat", 700)
    (folder / "000003-meta.mat").unlink()
    (recording,) = read_ycb_video(folder)
    assert [frame.index for frame in recording.scene.frames] == [4]
    assert recording.skipped == (
        "2 frames without a readable meta.mat: 2, 3",
        "1 frame with an unreadable or truncated depth image: 1",
    )
    for number in (1, 4):
        (folder / f"{number:06d}-meta.mat").write_bytes(b"")
    with pytest.raises(DataError, match="none of 4 frames has a readable meta.mat"):
        read_ycb_video(folder)


def test_what_does_not_fit_is_refused(dataset: Path) -> None:
    folder = dataset / "data/0060"
    write_meta(folder / "000001-meta.mat", poses(2)[0], poses=np.zeros((3, 4, 3)))
    with pytest.raises(DataError, match=r"poses \(3, 4, 3\) and cls_indexes \[5, 15\] do not fit"):
        read_ycb_video(folder)
    with pytest.raises(DataError, match="has no <number>-color.png"):
        read_ycb_video(folder.parent.parent / "image_sets")
    with pytest.raises(DataError, match="It looks like `format: ycb_video`"):
        open_scenes(dataset, "bop")
