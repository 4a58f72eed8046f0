"""True labels: keypoints where OpenCV projects them, silhouettes where the corners' hull is."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from pycocotools import mask as coco_mask

from rpl_data.evaluate.truth import box_mesh, true_labels, true_objects, truth_from_poses
from rpl_data.geometry import from_rotvec
from rpl_data.types import DataError, Frame, Intrinsics, Recording, Scene
from rpl_data.workspace.workspace import Workspace

CAMERA = Intrinsics(300.0, 310.0, 79.5, 59.5, 160, 120)
CORNERS = np.array([[x, y, z] for x in (-0.03, 0.03) for y in (-0.04, 0.04) for z in (-0.05, 0.05)])
POSE = from_rotvec(np.array([0.4, 0.5, -0.2]), np.array([0.01, -0.02, 0.5]))
AWAY = from_rotvec(np.zeros(3), np.array([5.0, 0.0, 0.5]))


def scene(frames: int = 3) -> Scene:
    made = tuple(Frame(i, i / 30, Path(f"{i}.png"), None) for i in range(frames))
    return Scene("s", CAMERA, 1e-3, made)


def content(*poses: np.ndarray | None) -> dict[str, object]:
    rows = [None if pose is None else pose.tolist() for pose in poses]
    return {"points_box": CORNERS.tolist(), "camera_from_box": {"s": rows}}


def test_silhouette_and_keypoints_agree_with_opencv() -> None:
    (frame,) = true_labels(scene(1), true_objects(content(POSE), source="t", meshes={}))
    (box,) = frame.instances
    expected, _ = cv2.projectPoints(CORNERS, cv2.Rodrigues(POSE[:3, :3])[0], POSE[:3, 3], CAMERA.matrix, None)
    np.testing.assert_allclose(box.keypoints_px, expected[:, 0], atol=1e-9)
    hull = cv2.convexHull(expected[:, 0].astype(np.float32))
    signed_px = np.array([[cv2.pointPolygonTest(hull, (u, v), True) for u in range(160)] for v in range(120)])
    mask = coco_mask.decode(box.mask_full)
    assert (mask[signed_px > 0.01] == 1).all() and (mask[signed_px < -0.01] == 0).all()
    assert sorted(set(box.visibility.tolist())) == [1, 2]
    nearest = np.argmin((CORNERS @ POSE[:3, :3].T + POSE[:3, 3])[:, 2])
    farthest = np.argmax((CORNERS @ POSE[:3, :3].T + POSE[:3, 3])[:, 2])
    assert (box.visibility[nearest], box.visibility[farthest]) == (2, 1)


def test_several_instances_stand_under_the_names_of_their_places() -> None:
    poses, beside = content(POSE, None), POSE.copy()
    beside[0, 3] += 0.1
    poses["camera_from_box"]["s/2"] = [beside.tolist()] * 2  # type: ignore[index]
    first, second = true_labels(scene(2), true_objects(poses, source="t", meshes={}))
    assert [one.instance for one in first.instances] == ["", "2"]
    np.testing.assert_array_equal(first.instances[1].camera_from_object, beside)
    assert [one.instance for one in second.instances] == ["2"]


def test_box_faces_look_outwards() -> None:
    mesh = box_mesh(CORNERS)
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), (a + b + c) / 3) > 0).all()
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(0.06 * 0.08 * 0.1)


def test_an_object_outside_the_image_has_no_instance_and_an_unknown_pose_no_frame() -> None:
    frames = list(true_labels(scene(3), true_objects(content(POSE, AWAY, None), source="t", meshes={})))
    assert [(f.frame, len(f.instances)) for f in frames] == [(0, 1), (1, 0)]


def test_a_truth_workspace_is_written(tmp_path: Path) -> None:
    workspace, truth = Workspace(tmp_path / "w"), Workspace(tmp_path / "t")
    workspace.save_recording(Recording(scene(1), None))
    poses = tmp_path / "truth.json"
    poses.write_text(json.dumps(content(POSE)))
    truth_from_poses(workspace, truth, poses)
    assert truth.mesh_file("box").exists() and truth.labelled_scene_names() == ["s"]
    np.testing.assert_allclose(truth.load_solution("box").model.points_object, CORNERS)


def test_poses_of_other_scenes_are_refused(tmp_path: Path) -> None:
    poses = tmp_path / "truth.json"
    poses.write_text(json.dumps(content(POSE)))
    with pytest.raises(DataError, match="give them the same names"):
        truth_from_poses(Workspace(tmp_path / "w"), Workspace(tmp_path / "t"), poses)


def test_a_broken_matrix_is_named() -> None:
    with pytest.raises(DataError, match="scene s, frame 1: expected a 4x4"):
        true_objects(content(POSE, np.eye(3)), source="truth.json", meshes={})
