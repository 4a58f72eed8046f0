"""Triangles drawn one by one, beside rays cast at the same mesh."""

from __future__ import annotations

import numpy as np

from rpl_data.geometry import from_rotvec
from rpl_data.label.compiled_raster import drawn_depth_m
from rpl_data.raycast import RayScene, render_depth_m
from rpl_data.types import Intrinsics, Mesh

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
        drawn_m = drawn_depth_m(mesh, CAMERA, pose, (rows, columns), nothing_m=1e3)
        assert drawn_m is not None
        hit = cast_m > 0
        differing = hit != (drawn_m < 1e3)
        assert 0.05 < hit.mean() < 0.95 and differing.sum() <= 0.001 * hit.sum()
        same = hit & (drawn_m < 1e3)
        assert (np.abs(drawn_m - cast_m)[same] > 1e-5).sum() <= 0.001 * hit.sum()


def test_a_mesh_that_reaches_behind_the_camera_is_not_drawn() -> None:
    mesh = crumpled(np.random.default_rng(4))
    pose = from_rotvec(np.zeros(3), np.array([0.0, 0.0, 0.05]))
    assert drawn_depth_m(mesh, CAMERA, pose, WHOLE, nothing_m=1e3) is None
