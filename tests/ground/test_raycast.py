"""Ray casting against hand-worked numbers and OpenCV's projection."""

from __future__ import annotations

import numpy as np
import pytest

from rpl_data.geometry import from_rotvec, project, rigid
from rpl_data.raycast import RayScene, pixel_rays, render_depth_m
from rpl_data.types import DataError, Intrinsics, Mesh

CAMERA = Intrinsics(500.0, 510.0, 319.5, 239.5, 640, 480)
LENS = Intrinsics(500.0, 510.0, 319.5, 239.5, 640, 480, (0.12, -0.25, 0.001, -0.0008, 0.05))
ALL = {"left_px": 0, "top_px": 0, "width": 640, "height": 480}


def square(half_m: float, z_m: float) -> Mesh:
    """A square around the z axis, facing -z."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float) * half_m
    return Mesh(corners + [0, 0, z_m], np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int64))


def test_cast_names_mesh_triangle_and_distance() -> None:
    scene = RayScene([square(0.1, 2.0), square(1.0, 3.0)])
    hits = scene.cast(
        np.array([[0.05, 0, 0, 0, 0, 1], [0.5, 0, 0, 0, 0, 1], [5, 0, 0, 0, 0, 1]], dtype=np.float32)
    )
    assert hits.t.tolist() == pytest.approx([2.0, 3.0, np.inf], abs=1e-6)
    assert hits.mesh_id.tolist() == [0, 1, -1]
    assert hits.triangle_id[2] == -1 and hits.triangle_id[0] in (0, 1)
    np.testing.assert_allclose(hits.normals[:2], [[0, 0, -1]] * 2, atol=1e-6)


def test_occluded_only_before_far() -> None:
    ray = np.array([[0, 0, 0, 0, 0, 1]], dtype=np.float32)
    scene = RayScene([square(0.1, 2.0)])
    assert scene.occluded(ray, far=2.1).tolist() == [True]
    assert scene.occluded(ray, far=1.9).tolist() == [False]


def test_plane_depth_is_along_the_optical_axis() -> None:
    depth = render_depth_m(
        RayScene([square(5.0, 0.0)]), CAMERA, rigid(np.eye(3), np.array([0, 0, 0.7])), **ALL
    )
    np.testing.assert_allclose(depth, 0.7, atol=1e-5)


def test_pixel_centres_decide_the_silhouette() -> None:
    # Half a side of 0.0995 m at 1 m and f = 500 reaches 49.75 px from 319.5: pixels 270 .. 369.
    depth = render_depth_m(RayScene([square(0.0995, 1.0)]), CAMERA, np.eye(4), **ALL)
    columns = np.flatnonzero(depth.any(axis=0))
    assert (columns[0], columns[-1]) == (270, 369)


@pytest.mark.parametrize("intrinsics", [CAMERA, LENS])
def test_pixel_rays_project_back_and_crops_are_slices(intrinsics: Intrinsics) -> None:
    rays = pixel_rays(intrinsics, left_px=10, top_px=20, width=60, height=40)
    uv = project(intrinsics, (rays * 0.8).reshape(-1, 3)).reshape(40, 60, 2)
    np.testing.assert_allclose(uv[..., 0], np.tile(np.arange(10, 70), (40, 1)), atol=1e-4)
    np.testing.assert_allclose(uv[..., 1], np.tile(np.arange(20, 60)[:, None], (1, 60)), atol=1e-4)
    whole = pixel_rays(intrinsics, **ALL)
    np.testing.assert_allclose(whole[20:60, 10:70], rays, atol=1e-12)


def test_depth_of_a_tilted_plane_lies_on_the_plane() -> None:
    camera_from_object = from_rotvec(np.array([0.4, -0.3, 0.2]), np.array([0.02, -0.01, 0.9]))
    depth = render_depth_m(RayScene([square(0.2, 0.0)]), LENS, camera_from_object, **ALL)
    points = pixel_rays(LENS, **ALL)[depth > 0] * depth[depth > 0][:, None]
    normal = camera_from_object[:3, 2]
    assert np.abs((points - camera_from_object[:3, 3]) @ normal).max() < 1e-5
    assert len(points) > 10_000


def test_no_triangles_is_refused() -> None:
    with pytest.raises(DataError, match="without triangles"):
        RayScene([Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))])
