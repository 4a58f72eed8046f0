"""What the 3D view is given: points of the scenes where the cameras saw them, and the dense model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from annotate_client import OBJECT, client_of, unpacked
from fastapi.testclient import TestClient

from rpl_data.geometry import inside_image, invert, project, transform
from rpl_data.images import read_depth_m
from rpl_data.meshes import load_mesh
from rpl_data.workspace.workspace import Workspace


@pytest.fixture
def client(root: Path) -> TestClient:
    return client_of(root)


@pytest.mark.parametrize("built", [True, False])
def test_points_of_a_scene_lie_where_its_camera_saw_them(
    root: Path, client: TestClient, tiny_workspace: Workspace, built: bool
) -> None:
    if not built:
        Workspace(root).surface_file("01").unlink()
    found = client.get(OBJECT + "/surfaces/01").json()
    points = unpacked(found["points"], "<f4")
    assert 300 <= len(points) <= 5000 and len(unpacked(found["colors"], "u1")) == len(points)
    scene = tiny_workspace.load_scene("01")
    camera_from_scene = invert(tiny_workspace.load_trajectory(scene).at(0))
    in_camera = transform(camera_from_scene, points)
    uv = project(scene.intrinsics, in_camera)
    seen = inside_image(scene.intrinsics, uv)
    u, v = np.rint(uv[seen]).astype(int).T
    off_m = np.abs(read_depth_m(scene, scene.frame(0))[v, u] - in_camera[seen, 2])
    assert seen.mean() > 0.9 and np.median(off_m) < 0.004


def test_before_the_first_click_there_is_nothing_to_show(root: Path, client: TestClient) -> None:
    (root / "objects/carton/clicks.jsonl").unlink()
    Workspace(root).append_events("carton", [{"op": "keypoints", "names": ["a", "b", "c"]}])
    assert client.get(OBJECT + "/surfaces/00").json() is None


def test_the_dense_model_comes_with_few_triangles_and_its_place(root: Path, client: TestClient) -> None:
    found: Any = client.get(OBJECT + "/dense").json()
    mesh = load_mesh(Workspace(root).mesh_file("carton"))
    points, triangles = unpacked(found["points"], "<f4"), unpacked(found["triangles"], "<u2").astype(int)
    assert len(triangles) <= 6000 and triangles.max() < len(points)
    for low_or_high in ("min", "max"):
        limits = [getattr(vertices, low_or_high)(axis=0) for vertices in (points, mesh.vertices)]
        np.testing.assert_allclose(*limits, atol=0.004)
    solution = Workspace(root).load_placed("carton")
    for name, place in solution.scene_from_object.items():
        np.testing.assert_allclose(np.reshape(found["places"][name], (4, 4)), place)
    Workspace(root).mesh_file("carton").unlink()
    assert client.get(OBJECT + "/dense").json() is None
