"""A person at a Python prompt looks into a workspace that was built."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rpl_data.geometry import invert
from rpl_data.images import read_color
from rpl_data.types import DataError, FrameLabel
from rpl_data.workspace.workspace import Workspace


def test_a_workspace_says_what_it_holds(tiny_workspace: Workspace, tmp_path: Path) -> None:
    assert str(tiny_workspace).endswith(
        "): 3 scenes with 18 frames, 1 object (carton), 18 labelled frames"
    ), tiny_workspace
    assert repr(Workspace("nowhere")) == "Workspace('nowhere'): not there yet"
    empty = Workspace(tmp_path)
    assert repr(empty).endswith(": 0 scenes with 0 frames, 0 objects, 0 labelled frames")
    empty.save_labels("00", [FrameLabel("00", 1, 0.0)])
    assert repr(empty).endswith("1 labelled frame")


@pytest.mark.parametrize("broken", ["scene.json", "parts.json"])
def test_a_broken_workspace_is_still_printed(tmp_path: Path, broken: str) -> None:
    path = tmp_path / "scenes/00" / broken
    path.parent.mkdir(parents=True)
    path.write_text("{")
    assert f"cannot be counted: {path} is not valid JSON" in repr(Workspace(tmp_path))


def test_text_is_a_path_and_home_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert Workspace(str(tmp_path)) == Workspace(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert Workspace("~/ws").root == tmp_path / "ws"


def test_labels_as_arrays_are_the_labels_as_objects(tiny_workspace: Workspace) -> None:
    arrays = tiny_workspace.label_arrays("carton")
    labels = [label for name in ("00", "01", "02") for label in tiny_workspace.labels(name)]
    assert len(arrays) == len(labels) == 18
    for row, label in enumerate(labels):
        (item,) = label.instances
        assert (arrays.scenes[row], arrays.frames[row]) == (label.scene, label.frame)
        assert arrays.timestamps_s[row] == label.timestamp_s
        np.testing.assert_array_equal(arrays.camera_from_object[row], item.camera_from_object)
        np.testing.assert_array_equal(arrays.keypoints_px[row], item.keypoints_px)
        np.testing.assert_array_equal(arrays.visibility[row], item.visibility)
        np.testing.assert_array_equal(arrays.boxes_px[row], item.box)
        assert (arrays.visib_fract[row], arrays.quality[row]) == (item.visib_fract, item.quality)
    only = tiny_workspace.label_arrays("carton", scene="01")
    assert set(only.scenes) == {"01"}
    assert repr(only) == "LabelArrays of carton: 6 labels in 1 scene, 11 keypoints"
    np.testing.assert_array_equal(only.camera_from_object, arrays.camera_from_object[6:12])


def test_model_and_mesh_are_in_the_frame_of_the_poses(tiny_workspace: Workspace) -> None:
    """Keypoints of the model, taken to the camera and projected, are the keypoints of the label."""
    arrays, model = tiny_workspace.label_arrays("carton", scene="00"), tiny_workspace.model("carton")
    scene = tiny_workspace.load_scene("00")
    camera_from_object = arrays.camera_from_object[2]
    points = model.points_object @ camera_from_object[:3, :3].T + camera_from_object[:3, 3]
    projected = points @ scene.intrinsics.matrix.T
    np.testing.assert_allclose(projected[:, :2] / projected[:, 2:], arrays.keypoints_px[2], atol=0.01)
    low, high = (f(tiny_workspace.mesh("carton").vertices, axis=0) for f in (np.min, np.max))
    assert (model.points_object > low - 0.02).all() and (model.points_object < high + 0.02).all()
    scene_from_object = tiny_workspace.load_placed("carton").scene_from_object["00"]
    scene_from_camera = tiny_workspace.load_trajectory(scene).at(int(arrays.frames[2]))
    np.testing.assert_allclose(camera_from_object, invert(scene_from_camera) @ scene_from_object, atol=1e-8)


def test_an_overlay_is_the_image_with_the_label_on_it(tiny_workspace: Workspace) -> None:
    frame = tiny_workspace.frames("01")[3]
    overlay, color = tiny_workspace.overlay("01", frame.index), read_color(frame)
    assert overlay.shape == color.shape and overlay.dtype == np.uint8
    changed = (overlay != color).any(axis=2)
    box = tiny_workspace.label_arrays("carton", scene="01").boxes_px[3].astype(int)
    inside = changed[box[1] : box[3], box[0] : box[2]]
    assert inside.mean() > 0.3 > changed.mean()


def test_labels_of_a_part_are_those_of_its_frames(tiny_workspace: Workspace, tmp_path: Path) -> None:
    cut = Workspace(tmp_path)
    recording = tiny_workspace.load_recording("00")
    cut.save_recording(recording)
    cut.save_trajectory(recording.scene, tiny_workspace.load_trajectory(recording.scene))
    cut.save_labels("00", tiny_workspace.load_labels("00"))
    cut.cut_scene("00", [(0, 2), (3, 5)])
    assert [label.frame for label in cut.labels("00.2")] == [3, 4, 5]
    assert [label.frame for label in cut.labels("00")] == [0, 1, 2, 3, 4, 5]
    assert cut.label_arrays("carton").frames.tolist() == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    ("look", "message"),
    [
        (lambda w: w.labels("07"), "there is no scene 07 in .*Scenes with labels: 00, 01, 02"),
        (lambda w: w.frames("07"), "has no scene '07'"),
        (lambda w: w.label_arrays("cup"), "no object cup in .*; its objects are: carton"),
        (lambda w: w.model("cup"), "no object cup in .*; its objects are: carton"),
        (lambda w: w.mesh("cup"), "no object cup in .*; its objects are: carton"),
        (lambda w: w.overlay("00", 99), "no label of frame 99; the nearest with one is 5"),
    ],
)
def test_what_is_not_there_is_said(tiny_workspace: Workspace, look: object, message: str) -> None:
    assert callable(look)
    with pytest.raises(DataError, match=message):
        look(tiny_workspace)
