"""Views that look the same are labelled the same, whichever symmetric pose they were labelled with."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from labelled_scenes import BOX, CAMERA, exported, instance

from rpl_data.formats.datasets.coco import CocoObject, header, instance_to_coco
from rpl_data.geometry import from_rotvec, project, square_box, transform
from rpl_data.symmetries import symmetry_transforms, turn
from rpl_data.torch import KeypointDataModule, KeypointDataset
from rpl_data.torch.symmetric import canonical_keypoints, canonical_label, canonical_symmetry
from rpl_data.types import Symmetries, SymmetryAxis

UPRIGHT = SymmetryAxis((0.0, 0.6, 0.8), (0.01, 0.0, 0.02))
ACROSS = SymmetryAxis((1.0, 0.0, 0.0), (0.01, 0.0, 0.02))
HALF = tuple(turn(ACROSS, np.pi).ravel().tolist())
THIRDS = tuple(tuple(turn(UPRIGHT, 2 * np.pi * k / 3).ravel().tolist()) for k in (1, 2))
KINDS = [Symmetries((HALF,)), Symmetries(THIRDS), Symmetries((), (UPRIGHT,)), Symmetries((HALF,), (UPRIGHT,))]


@pytest.mark.parametrize("symmetries", KINDS)
def test_every_pose_that_looks_the_same_gets_one_label(symmetries):
    rng = np.random.default_rng(3)
    for _ in range(5):
        pose = from_rotvec(rng.normal(size=3), np.array([0.0, 0.0, 0.7]))
        first = pose @ canonical_symmetry(symmetries, pose)
        for number in rng.integers(0, len(symmetry_transforms(symmetries)), 4):
            same = pose @ symmetry_transforms(symmetries)[number]
            np.testing.assert_allclose(same @ canonical_symmetry(symmetries, same), first, atol=1e-9)


@pytest.mark.parametrize("symmetries", KINDS)
def test_the_chosen_pose_is_one_of_those_that_look_the_same_and_nearest_to_the_camera(symmetries):
    pose = from_rotvec(np.array([0.4, -2.0, 0.8]), np.array([0.1, 0.0, 0.7]))
    chosen = canonical_symmetry(symmetries, pose)
    listed = symmetry_transforms(symmetries, max_deviation=0.002)
    assert np.abs(listed - chosen).max(axis=(1, 2)).min() < 0.003  # the steps of the list are this fine
    assert np.trace((pose @ chosen)[:3, :3]) >= max(np.trace((pose @ one)[:3, :3]) for one in listed) - 1e-9


def test_visibility_goes_with_the_place():
    half = Symmetries((HALF,))
    points = np.array([[0.05, 0.0, 0.02], [0.0, 0.03, 0.05], [0.01, -0.02, 0.02], [np.nan] * 3])
    points[2] = transform(np.reshape(HALF, (4, 4)), points[1])
    keypoints = np.array([[10.0, 10.0, 2.0], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [0.0, 0.0, 0.0]])
    pose = from_rotvec(np.zeros(3), np.array([0.0, 0.0, 0.7]))
    found = canonical_keypoints(keypoints, pose, np.reshape(HALF, (4, 4)), points, CAMERA)
    assert found[:, 2].tolist() == [2, 2, 1, 0]  # on the axis; the two that change places; never clicked
    np.testing.assert_allclose(found[1, :2], project(CAMERA, transform(pose, points[2:3]))[0])
    assert canonical_symmetry(half, pose).tolist() == np.eye(4).tolist()


def test_the_box_of_one_keypoint_stays():
    box, pose = np.array([40.0, 30.0, 25.0]), turn(ACROSS, np.pi)
    pose[2, 3] += 0.7
    found = canonical_label(
        pose, np.array([[10.0, 10.0, 2.0]]), box, Symmetries((HALF,)), np.array([[0.0, 0.03, 0.05]]), CAMERA
    )
    assert not np.allclose(found[0], pose) and found[2] is box


def test_a_dataset_of_two_equal_views_has_two_equal_labels(tmp_path):
    file = exported(tmp_path) / "train.json"
    data = json.loads(file.read_text())
    symmetries = Symmetries((HALF,), (UPRIGHT,))
    data["rpl"] = header([CocoObject(BOX, symmetries=symmetries), *others(data)])["rpl"]
    pose = from_rotvec(np.array([0.3, 0.2, 0.1]), np.array([0.02, 0.01, 0.6]))
    data["annotations"] = [
        entry(number, data["images"][0]["id"], pose @ symmetry_transforms(symmetries)[row])
        for number, row in ((1, 0), (2, 400))
    ]
    file.write_text(json.dumps(data))
    plain, same = (KeypointDataset(file, object="box", canonical=canonical) for canonical in (False, True))
    assert (plain[0]["keypoints_px"] - plain[1]["keypoints_px"])[:3].abs().max() > 5
    for key in ("keypoints_px", "camera_from_object", "square_box", "heatmaps"):
        np.testing.assert_allclose(same[0][key], same[1][key], atol=1e-4, err_msg=key)
    module = KeypointDataModule(file.parent, object="box", canonical=True)  # as `rpl train keypoints` asks
    assert np.array_equal(module.train[1]["camera_from_object"], same[1]["camera_from_object"])
    points = transform(same[0]["camera_from_object"].numpy(), BOX.points_object[:3])
    np.testing.assert_allclose(project(CAMERA, points), same[0]["keypoints_px"][:3], atol=1e-6)


def others(data):
    from rpl_data.formats.datasets.coco import objects_from_coco

    return objects_from_coco(data)[1:]


def entry(number, image_id, pose):
    label = instance(BOX, 0.0)
    uv = project(CAMERA, transform(pose, BOX.points_object))
    moved = replace(
        label, camera_from_object=pose, keypoints_px=uv, square_box=square_box(uv[np.isfinite(uv[:, 0])])
    )
    return instance_to_coco(number, image_id, 1, moved)
