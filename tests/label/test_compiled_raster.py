"""Triangles drawn one by one, beside rays cast at the same mesh."""

from __future__ import annotations

import numpy as np
import pytest

from rpl_data.geometry import from_rotvec
from rpl_data.label.compiled_raster import DrawnMesh, drawn_depth_m
from rpl_data.raycast import RayScene, render_depth_m
from rpl_data.types import DataError, Intrinsics, Mesh

CAMERA = Intrinsics(300.0, 310.0, 79.3, 59.6, 160, 120)
WHOLE = (slice(0, 120), slice(0, 160))


def crumpled(rng: np.random.Generator) -> Mesh:
    """Triangles of all sizes anyhow, and a sheet whose triangles share their edges."""
    loose = rng.uniform(-0.1, 0.1, (60, 3))
    x, y = np.meshgrid(np.linspace(-0.08, 0.08, 40), np.linspace(-0.08, 0.08, 40))
    sheet = np.column_stack([x.ravel(), y.ravel(), 0.05 + 0.01 * np.sin(60 * x.ravel())])
    corner = np.arange(39 * 40).reshape(39, 40)[:, :-1].ravel()
    squares = np.concatenate(
        [
            np.column_stack([corner, corner + 1, corner + 40]),
            np.column_stack([corner + 1, corner + 41, corner + 40]),
        ]
    )
    triangles = np.concatenate([np.arange(60).reshape(-1, 3), 60 + squares])
    return Mesh(np.concatenate([loose, sheet]), triangles.astype(np.int64))


def test_a_drawn_mesh_is_what_rays_hit() -> None:
    rng = np.random.default_rng(4)
    for _ in range(5):
        mesh = crumpled(rng)
        pose = from_rotvec(rng.uniform(-2, 2, 3), np.array([0.02, 0.0, 0.4]))
        rows, columns = slice(10, 115), slice(5, 150)
        size = {"width": 145, "height": 105}
        cast_m = render_depth_m(RayScene([mesh]), CAMERA, pose, left_px=5, top_px=10, **size)
        drawn_m = drawn_depth_m(DrawnMesh.of(mesh), CAMERA, pose, (rows, columns), nothing_m=1e3)
        assert drawn_m is not None
        hit = cast_m > 0
        differing = hit != (drawn_m < 1e3)
        assert 0.05 < hit.mean() < 0.95 and differing.sum() <= 0.001 * hit.sum()
        same = hit & (drawn_m < 1e3)
        assert (np.abs(drawn_m - cast_m)[same] > 1e-5).sum() <= 0.001 * hit.sum()


def test_a_mesh_that_reaches_behind_the_camera_is_not_drawn() -> None:
    mesh = crumpled(np.random.default_rng(4))
    pose = from_rotvec(np.zeros(3), np.array([0.0, 0.0, 0.05]))
    assert drawn_depth_m(DrawnMesh.of(mesh), CAMERA, pose, WHOLE, nothing_m=1e3) is None


TETRAHEDRON = Mesh(
    np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 0.1 - 0.03,
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)


def beside(first: Mesh, second: Mesh) -> Mesh:
    """Two parts of one mesh, 0.2 m apart."""
    triangles = np.concatenate([first.triangles, second.triangles + len(first.vertices)])
    return Mesh(np.concatenate([first.vertices, second.vertices + [0.2, 0, 0]]), triangles)


def test_triangles_seen_from_behind_are_left_out_only_where_others_hide_them() -> None:
    inside_out = Mesh(TETRAHEDRON.vertices, TETRAHEDRON.triangles[:, ::-1])
    torn = Mesh(TETRAHEDRON.vertices, TETRAHEDRON.triangles[1:])
    assert DrawnMesh.of(TETRAHEDRON).closed and DrawnMesh.of(beside(TETRAHEDRON, TETRAHEDRON)).closed
    assert not DrawnMesh.of(inside_out).closed and not DrawnMesh.of(torn).closed
    assert not DrawnMesh.of(beside(TETRAHEDRON, inside_out)).closed
    assert not DrawnMesh.of(beside(TETRAHEDRON, torn)).closed
    mirrored = TETRAHEDRON.vertices[0] - 0.7 * (TETRAHEDRON.vertices - TETRAHEDRON.vertices[0])
    bow_tie = Mesh(  # joined in a vertex; the smaller one is inside out
        np.concatenate([TETRAHEDRON.vertices, mirrored[1:]]),
        np.concatenate([TETRAHEDRON.triangles, np.array([0, 4, 5, 6])[TETRAHEDRON.triangles]]),
    )
    assert not DrawnMesh.of(bow_tie).closed
    for mesh in (TETRAHEDRON, inside_out, torn, bow_tie):
        pose = from_rotvec(np.array([0.4, 0.9, -0.2]), np.array([0.0, 0.0, 0.4]))
        drawn_m = drawn_depth_m(DrawnMesh.of(mesh), CAMERA, pose, WHOLE, nothing_m=1e3)
        cast_m = render_depth_m(RayScene([mesh]), CAMERA, pose, left_px=0, top_px=0, width=160, height=120)
        np.testing.assert_allclose(drawn_m, np.where(cast_m > 0, cast_m, 1e3), atol=1e-6)


def test_a_triangle_without_area_draws_nothing_and_one_without_a_corner_is_refused() -> None:
    line = Mesh(np.array([[-0.1, 0, 0.5], [0, 0, 0.5], [0.1, 0, 0.5]]), np.array([[0, 1, 2], [1, 1, 2]]))
    drawn_m = drawn_depth_m(DrawnMesh.of(line), CAMERA, np.eye(4), WHOLE, nothing_m=1e3)
    assert drawn_m is not None and (drawn_m == 1e3).all()
    with pytest.raises(DataError, match="3 vertices"):
        DrawnMesh.of(Mesh(line.vertices, np.array([[0, 1, 3]])))
