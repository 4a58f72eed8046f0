"""Grasp frames: right-handed, out of the surface, as worked by hand and as written to files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rpl_data.clicks.grasp import grasp_frame
from rpl_data.formats.models.sparse_model import read_grasp, read_sparse_model, write_sparse_model
from rpl_data.geometry import from_rotvec, invert, project, rays, transform
from rpl_data.types import DataError, Intrinsics

CAMERA = Intrinsics(500.0, 500.0, 159.5, 119.5, 320, 240)


def depth_of_plane(normal: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Depth of a plane in every pixel."""
    v, u = np.mgrid[0:240, 0:320].reshape(2, -1)
    directions = rays(CAMERA, np.column_stack([u, v]).astype(float))
    return ((normal @ point) / (directions @ normal)).reshape(240, 320).astype(np.float32)


def test_a_wall_before_the_camera_by_hand() -> None:
    depth_m = np.full((240, 320), 0.5, np.float32)
    frame = grasp_frame(CAMERA, depth_m, (159.5, 119.5), (209.5, 119.5))
    np.testing.assert_allclose(frame[:3, 3], [0, 0, 0.5], atol=1e-9)
    # x to the right as clicked, z back to the camera, so y = z x x points up.
    np.testing.assert_allclose(frame[:3, :3], [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_on_any_plane_it_is_right_handed_and_looks_at_the_camera(seed: int) -> None:
    generator = np.random.default_rng(seed)
    point = np.array([0.02, -0.03, 0.6])
    normal = np.array([*generator.uniform(-0.6, 0.6, 2), -1.0])
    normal /= np.linalg.norm(normal)
    noisy = depth_of_plane(normal, point) + generator.normal(0, 0.0003, (240, 320)).astype(np.float32)
    clicks = [tuple(map(float, uv)) for uv in generator.uniform(60, 180, (2, 2))]
    frame = grasp_frame(CAMERA, noisy, clicks[0], clicks[1])
    rotation = frame[:3, :3]
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1)
    assert np.degrees(np.arccos(rotation[:, 2] @ normal)) < 3
    assert abs((frame[:3, 3] - point) @ normal) < 0.001
    along = frame[:3, 3] + 0.02 * rotation[:, 0]
    uv = project(CAMERA, np.array([frame[:3, 3], along]))
    np.testing.assert_allclose(uv[0], clicks[0], atol=0.01)
    toward, drawn = np.array(clicks[1]) - clicks[0], uv[1] - uv[0]
    assert toward @ drawn == pytest.approx(np.linalg.norm(toward) * np.linalg.norm(drawn), rel=1e-4)


def test_it_moves_with_the_scene() -> None:
    """The same wall, seen by a camera turned about its own axis: the same frame in space."""
    depth_m = np.full((240, 320), 0.5, np.float32)
    turned = from_rotvec(np.array([0, 0, np.pi]), np.zeros(3))
    one = grasp_frame(CAMERA, depth_m, (149.5, 109.5), (199.5, 119.5))
    other = grasp_frame(CAMERA, depth_m, (169.5, 129.5), (119.5, 119.5))
    np.testing.assert_allclose(turned @ other, one, atol=1e-9)


@pytest.mark.parametrize(
    ("clicks", "message"),
    [
        (((20.0, 20.0), (60.0, 20.0)), "no depth where the grasp"),
        (((150.0, 120.0), (150.0, 120.0)), "on one spot"),
    ],
)
def test_what_cannot_be_a_grasp_is_refused(clicks: tuple[tuple[float, float], ...], message: str) -> None:
    depth_m = np.full((240, 320), 0.5, np.float32)
    depth_m[:40, :40] = 0
    with pytest.raises(DataError, match=message):
        grasp_frame(CAMERA, depth_m, clicks[0], clicks[1])


def test_an_edge_with_too_little_surface_is_refused() -> None:
    depth_m = np.zeros((240, 320), np.float32)
    depth_m[118:121, 158:161] = 0.5
    with pytest.raises(DataError, match="click farther from the edge"):
        grasp_frame(CAMERA, depth_m, (159.0, 119.0), (180.0, 119.0))


def test_the_sparse_model_file_carries_it(tmp_path: Path) -> None:
    path, points = tmp_path / "sparse_model.txt", np.arange(12.0).reshape(4, 3) / 7
    grasp = from_rotvec(np.array([0.3, -1.2, 0.4]), np.array([0.1, -2e-5, 0.7]))
    write_sparse_model(path, points, grasp)
    np.testing.assert_array_equal(read_sparse_model(path), points)
    found = read_grasp(path)
    assert found is not None
    np.testing.assert_array_equal(found, grasp)
    np.testing.assert_allclose(transform(invert(found), found[None, :3, 3]), 0, atol=1e-12)
    write_sparse_model(path, points)
    assert read_grasp(path) is None
