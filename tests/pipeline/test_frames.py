"""Canonical frames of exports: hand-worked axes, and an image in which nothing moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from built_once import moved_copy

from rpl_data.formats.datasets.coco import intrinsics_from_coco, objects_from_coco, read_coco
from rpl_data.geometry import from_rotvec, project, transform
from rpl_data.json_arrays import matrix_from_json
from rpl_data.meshes import load_mesh, save_mesh
from rpl_data.pipeline.build import context_of
from rpl_data.pipeline.frames import boxed_frame, common_direction, exported_mesh, frame_of_keypoints
from rpl_data.pipeline.recipe import AxisRecipe
from rpl_data.pipeline.stages.export import EXPORTS
from rpl_data.raycast import RayScene, render_depth_m
from rpl_data.symmetries import symmetry_transforms
from rpl_data.types import DataError, KeypointModel, Mesh
from rpl_data.workspace.workspace import Workspace

POINTS = np.array([[1.0, 1.0, 1.0], [1.0, 3.0, 1.0], [0.0, 2.0, 1.0], [np.nan] * 3, [1.0, 2.0, 1.0]])
MODEL = KeypointModel("cup", ("a", "b", "c", "d", "e"), POINTS)


def test_three_keypoints_are_origin_x_and_plane():
    frame = frame_of_keypoints(MODEL, ("a", "b", "c"))
    np.testing.assert_allclose(transform(frame, POINTS[:3]), [[0, 0, 0], [2, 0, 0], [1, 1, 0]], atol=1e-15)
    assert np.linalg.det(frame[:3, :3]) == pytest.approx(1)


@pytest.mark.parametrize(
    ("names", "fault"), [(("a", "b", "x"), "'x'"), (("a", "b", "d"), "'d'"), (("a", "b", "e"), "on a line")]
)
def test_keypoints_that_make_no_frame_are_named(names, fault):
    with pytest.raises(DataError, match=fault):
        frame_of_keypoints(MODEL, names)


def test_the_origin_is_the_centre_of_the_box():
    frame = boxed_frame(POINTS[:3], np.eye(3)[[1, 2, 0]])
    np.testing.assert_allclose(transform(frame, POINTS[:3]), [[-1, 0, 0.5], [1, 0, 0.5], [0, 0, -0.5]])


def test_the_side_an_object_stands_on_most_often_is_its_foot():
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.1, 0.995], [0.0, -0.1, 0.995], [1.0, 0.0, 0.0]])
    np.testing.assert_allclose(common_direction(normals), [0, 0, 1], atol=1e-9)
    assert common_direction(np.zeros((0, 3))) is None


def seen(place: Workspace):
    """Where keypoints, vertices, mask and turned copies of the keypoints appear in two images."""
    data = read_coco(place.export("coco") / "train.json")
    (item,) = objects_from_coco(data)
    mesh = load_mesh(place.export("coco") / item.mesh)
    images = {image["id"]: image for image in data["images"]}
    found = []
    for annotation in data["annotations"][:2]:
        camera = intrinsics_from_coco(images[annotation["image_id"]])
        pose = matrix_from_json(annotation["camera_from_object"])
        window = {"left_px": 0, "top_px": 0, "width": camera.width, "height": camera.height}
        mask = render_depth_m(RayScene([mesh]), camera, pose, **window) > 0
        turned = transform(symmetry_transforms(item.symmetries)[1], item.model.points_object)
        points = [item.model.points_object, mesh.vertices, turned]
        pixels = np.concatenate([project(camera, transform(pose, one)) for one in points])
        found.append((pixels, mask, annotation["keypoints"]))
    return found, item


def test_another_frame_moves_nothing_in_the_image(tiny_workspace, tmp_path):
    place = Workspace(moved_copy(tiny_workspace.root, tmp_path / "copy"))
    context = context_of(place)
    symmetric = replace(context.objects[0], symmetry=(AxisRecipe((0.0, 0.6, 0.8), 2, (0.0, 0.01, 0.0)),))
    context = replace(context, recipe=replace(context.recipe, objects=(symmetric,)))

    def exported(frame):
        recipe = replace(context.recipe, export=replace(context.recipe.export, frame=frame))
        EXPORTS["coco"](replace(context, recipe=recipe))
        return seen(place)

    before, own = exported("keypoints")
    names = own.model.keypoints
    assert own.frame is None
    for frame in ("box", "up", names[:3]):
        after, item = exported(frame)
        for (pixels, mask, labelled), (same, same_mask, same_labelled) in zip(before, after, strict=True):
            np.testing.assert_allclose(same, pixels, atol=1e-6)
            assert (mask == same_mask).all() and mask.any() and labelled == same_labelled
        np.testing.assert_allclose(
            item.model.points_object, transform(item.frame, own.model.points_object), atol=1e-12
        )
        if frame != names[:3]:
            vertices = load_mesh(place.export("coco") / item.mesh).vertices
            np.testing.assert_allclose(vertices.min(axis=0), -vertices.max(axis=0), atol=1e-9)


def test_meshes_in_another_frame_are_not_written_to_the_truth(tmp_path):
    """It may be somebody's recording."""
    own, truth = Workspace(tmp_path / "own"), Workspace(tmp_path / "truth")
    save_mesh(truth.mesh_file("cup"), Mesh(np.eye(3), np.array([[0, 1, 2]])))
    before = sorted((tmp_path / "truth").rglob("*"))
    shift = from_rotvec(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    path = exported_mesh(own, truth, "cup", shift)
    assert sorted((tmp_path / "truth").rglob("*")) == before
    np.testing.assert_allclose(load_mesh(path).vertices, np.eye(3) + [0, 0, 1], atol=1e-6)
