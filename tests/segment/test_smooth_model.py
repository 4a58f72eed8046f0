"""The paper's region growing: it spreads over what is smooth and stops where the surface bends."""

from __future__ import annotations

import numpy as np
import pytest

from rpl_data.geometry import from_rotvec, transform
from rpl_data.segment.smooth_model import join_smooth_regions
from rpl_data.segment.smooth_regions import grow_from_seeds
from rpl_data.types import DataError, KeypointModel, Mesh, Solution

STEP_M = 0.003


def sheet(width: int, height: int) -> np.ndarray:
    """Points of a table top, 3 mm apart, z = 0; its first corner is the origin."""
    i, j = np.meshgrid(np.arange(width), np.arange(height), indexing="ij")
    return STEP_M * np.column_stack([i.ravel(), j.ravel(), np.zeros(i.size)])


def table() -> tuple[np.ndarray, np.ndarray]:
    """A top of 40 x 40 points, and the apron that hangs down from its edge x = 0."""
    top, apron = sheet(40, 40), sheet(14, 40)[:, [2, 1, 0]] * [1, 1, -1]
    points = np.concatenate([top, apron[apron[:, 2] < 0]])
    return points, points[:, 2] == 0


def test_growth_stops_at_the_edge_of_the_table() -> None:
    points, top = table()
    grown = grow_from_seeds(points, points[[20 * 40 + 20]], most_points=10_000)
    inner = top & (points[:, 0] > 0.012)
    assert grown[inner].all()
    assert not grown[~top & (points[:, 2] < -0.012)].any()


def test_a_seed_beside_the_points_grows_what_is_near_and_one_far_away_nothing() -> None:
    points = sheet(40, 40)
    assert grow_from_seeds(points, points[[820]] + [0, 0, 0.002], most_points=10_000).all()
    assert not grow_from_seeds(points, points[[820]] + [0, 0, 0.05]).any()


def test_growth_ends_with_the_number_of_points() -> None:
    points = sheet(80, 80)
    grown = grow_from_seeds(points, points[[40 * 80 + 40]], most_points=500)
    assert 500 <= grown.sum() < 1000
    spread = points[grown] - points[40 * 80 + 40]
    assert np.linalg.norm(spread, axis=1).max() < 1.5 * np.sqrt(500 / np.pi) * STEP_M  # round, not a strip


def test_regions_do_not_spread_from_curved_points() -> None:
    """On a cylinder of 25 mm radius a neighbourhood's surface variation is about 0.01."""
    angle, along = np.meshgrid(np.linspace(0, np.pi, 27), np.arange(30) * STEP_M, indexing="ij")
    points = np.column_stack([0.025 * np.cos(angle.ravel()), 0.025 * np.sin(angle.ravel()), along.ravel()])
    seed = points[[13 * 30 + 15]]
    wide = {"max_angle_rad": 0.4, "most_points": 10_000}
    assert grow_from_seeds(points, seed, **wide, max_curvature=0.05).all()
    one_ring = grow_from_seeds(points, seed, **wide, max_curvature=0.001)
    assert 0 < one_ring.sum() <= 30


def mesh_of(width: int, height: int) -> Mesh:
    number = np.arange(width * height).reshape(width, height)
    p, q, r, s = (n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    return Mesh(
        sheet(width, height), np.concatenate([np.column_stack([p, q, r]), np.column_stack([p, r, s])])
    )


def test_the_regions_of_all_scenes_are_joined_in_the_object_frame() -> None:
    scene_from_object = {"00": np.eye(4), "01": from_rotvec(np.array([0, 0.4, 0]), np.array([1.0, 2, 3]))}
    flat = mesh_of(30, 20)
    surfaces = {
        name: Mesh(transform(pose, flat.vertices), flat.triangles) for name, pose in scene_from_object.items()
    }
    keypoints = flat.vertices[[0, 19, 599]]
    solution = Solution(
        KeypointModel("plate", ("a", "b", "c"), keypoints), np.zeros((3, 3, 3)), scene_from_object
    )
    dense = join_smooth_regions({**surfaces, "02": flat}, solution)
    assert len(dense.cloud.points) == pytest.approx(600, abs=60)
    assert np.abs(dense.cloud.points[:, 2]).max() < 1e-9
    assert len(dense.mesh.triangles) == 2 * len(flat.triangles) and dense.open_edges > 0
    assert dense.warnings == ("scene 02 has no surface at the keypoints",)
    half = join_smooth_regions(surfaces, solution, crop_m=((-1.0, -1.0, -1.0), (0.0435, 1.0, 1.0)))
    assert half.cloud.points[:, 0].max() < 0.0435 < dense.cloud.points[:, 0].max()
    far = {"00": Mesh(flat.vertices + 1, flat.triangles)}
    with pytest.raises(DataError, match="within 8 mm of 0 of them in scene 00"):
        join_smooth_regions(far, solution)
