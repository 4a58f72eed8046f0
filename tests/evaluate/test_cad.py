"""The paper's protocol on shapes whose alignment is known."""

from __future__ import annotations

import numpy as np
import pytest

from rpl_data.evaluate.cad import Cad, align_scene, align_sparse, scaled
from rpl_data.evaluate.truth import box_mesh
from rpl_data.formats.models.meshlab import picked_in_order
from rpl_data.geometry import from_rotvec, invert, rotation_angle_rad, transform
from rpl_data.types import DataError, KeypointModel, Mesh

CORNERS = np.array([[x, y, z] for x in (-0.045, 0.045) for y in (-0.03, 0.03) for z in (-0.07, 0.07)])
NAMES = tuple("abcdefgh")
MOVED = from_rotvec(np.array([0.3, -0.2, 0.9]), np.array([0.4, -0.1, 0.7]))


def carton(picked: np.ndarray = CORNERS) -> Cad:
    return Cad("carton", box_mesh(CORNERS), picked)


def plate(origin: np.ndarray, a: np.ndarray, b: np.ndarray, *, step_m: float = 0.003) -> Mesh:
    """A fine rectangle with corners origin, origin + a, origin + b; it faces along a x b."""
    i, j = (np.linspace(0, 1, round(np.linalg.norm(side) / step_m) + 1) for side in (a, b))
    vertices = origin + i[:, None, None] * a + j[None, :, None] * b
    at = np.arange(len(i) * len(j)).reshape(len(i), len(j))
    p, q, r, s = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    triangles = np.concatenate(
        [np.stack([p, q, r], -1).reshape(-1, 3), np.stack([p, r, s], -1).reshape(-1, 3)]
    )
    return Mesh(vertices.reshape(-1, 3), triangles.astype(np.int64))


def seen_from_one_side(noise_m: float) -> Mesh:
    """Top, front and one side of the carton, and the table it stands on, as a scene shows them."""
    x, y, z = np.diag([0.09, 0.06, 0.14])
    low, high = CORNERS.min(axis=0), CORNERS.max(axis=0)
    parts = [
        plate(high - x - y, x, y),  # the top
        plate(low, x, z),  # the front, seen from -y
        plate(low + x, y, z),  # a side, seen from +x
        plate(low - 3 * x - 3 * y, 6 * x, 6 * y, step_m=0.006),  # the table
    ]
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    vertices = np.concatenate([part.vertices for part in parts])
    vertices = vertices + noise_m * np.random.default_rng(0).standard_normal(vertices.shape)
    triangles = np.concatenate([p.triangles + o for p, o in zip(parts, offsets, strict=True)])
    return Mesh(transform(MOVED, vertices), triangles)


def error_of(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Farthest corner in mm, angle in degrees."""
    apart = transform(found, CORNERS) - transform(true, CORNERS)
    angle = rotation_angle_rad((invert(true) @ found)[:3, :3])
    return 1e3 * float(np.linalg.norm(apart, axis=1).max()), float(np.rad2deg(angle))


# The sparse model ---------------------------------------------------------------------------------


def test_a_perfect_model_lies_on_the_cad_however_roughly_it_was_picked() -> None:
    picked = CORNERS + 0.003 * np.random.default_rng(1).standard_normal(CORNERS.shape)
    found = align_sparse(carton(picked), KeypointModel("carton", NAMES, transform(MOVED, CORNERS)))
    np.testing.assert_allclose(found.distances_m, 0, atol=1e-5)
    np.testing.assert_allclose(found.gt_sparse, CORNERS, atol=1e-5)


def test_closest_points_flatter() -> None:
    """Distances to closest points after ICP are below those to the true points: a law of the protocol."""
    noise = 0.002 * np.random.default_rng(2).standard_normal(CORNERS.shape)
    found = align_sparse(carton(), KeypointModel("carton", NAMES, CORNERS + noise))
    assert 0 < found.distances_m.mean() < np.linalg.norm(noise, axis=1).mean()


def test_unknown_keypoints_stay_unknown() -> None:
    points, picked = CORNERS.copy(), CORNERS.copy()
    points[0], picked[1] = np.nan, np.nan
    found = align_sparse(carton(picked), KeypointModel("carton", NAMES, points))
    assert np.isnan(found.gt_sparse[0]).all() and np.isnan(found.distances_m[0])
    np.testing.assert_allclose(found.distances_m[1:], 0, atol=1e-6)


def test_too_few_common_points_are_refused() -> None:
    points = np.full_like(CORNERS, np.nan)
    points[:2] = CORNERS[:2]
    with pytest.raises(DataError, match="only 2 of its keypoints"):
        align_sparse(carton(), KeypointModel("carton", NAMES, points))
    with pytest.raises(DataError, match="fewer than 3 picked"):
        Cad("carton", box_mesh(CORNERS), points)


# A scene ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_a_scene_pulls_the_cad_from_a_rough_start_onto_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    away = from_rotvec(np.deg2rad(5) * rng.standard_normal(3), 0.006 * rng.standard_normal(3))
    found = align_scene(carton(), seen_from_one_side(0.0005), MOVED @ away)
    off_mm, off_deg = error_of(found.scene_from_cad, MOVED)
    assert off_mm < 0.4 and off_deg < 0.2
    assert found.rms_m < 0.001 and found.points > 500


def test_a_cad_far_from_its_own_origin_is_aligned_as_well() -> None:
    shift = from_rotvec(np.zeros(3), np.array([2.0, -1.0, 0.5]))
    far = Cad("carton", box_mesh(transform(shift, CORNERS)), transform(shift, CORNERS))
    away = from_rotvec(np.array([0.05, -0.04, 0.03]), np.array([0.004, 0.005, -0.003]))
    found = align_scene(far, seen_from_one_side(0.0005), MOVED @ away @ invert(shift))
    assert error_of(found.scene_from_cad @ shift, MOVED)[0] < 0.4


def test_a_start_elsewhere_is_refused() -> None:
    elsewhere = MOVED @ from_rotvec(np.zeros(3), np.array([0.0, 0.0, 0.5]))
    with pytest.raises(DataError, match="only 0 points of the surface"):
        align_scene(carton(), seen_from_one_side(0.0), elsewhere)


def test_millimetres_are_refused_until_their_unit_is_given() -> None:
    in_mm = box_mesh(1e3 * CORNERS)
    with pytest.raises(DataError, match="expected metres"):
        Cad("carton", in_mm, 1e3 * CORNERS)
    np.testing.assert_allclose(
        Cad("carton", scaled(in_mm, 0.001), CORNERS).mesh.vertices, carton().mesh.vertices
    )


# Picked points ------------------------------------------------------------------------------------


def test_picked_points_find_their_keypoints_by_name_or_number() -> None:
    found = picked_in_order(
        ("lid", "2"), np.array([[1.0, 2, 3], [4, 5, 6]]), ("base", "lid", "cap"), source="a"
    )
    assert np.isnan(found[0]).all()
    np.testing.assert_array_equal(found[1:], [[1, 2, 3], [4, 5, 6]])


def test_a_point_of_another_name_is_refused() -> None:
    with pytest.raises(DataError, match="'nose' is not a keypoint"):
        picked_in_order(("nose",), np.zeros((1, 3)), ("a", "b"), source="x.pp")


@pytest.mark.parametrize("names", [("1", "2", "3"), ("1", "2", "3", "4"), ("2",)])
@pytest.mark.parametrize("keypoints", [("0", "1", "2", "3"), ("base", "lid", "cap", "knob")])
def test_points_numbered_from_one_are_refused(names: tuple[str, ...], keypoints: tuple[str, ...]) -> None:
    """Point 1 of a file without point 0 may be keypoint 0 or 1."""
    with pytest.raises(DataError, match=r"a.pp: its points are numbered from .*or number them from 0"):
        picked_in_order(names, np.zeros((len(names), 3)), keypoints, source="a.pp")


def test_keypoints_that_are_called_by_numbers_are_matched_by_name() -> None:
    found = picked_in_order(("1", "3"), np.array([[1.0] * 3, [3.0] * 3]), ("3", "2", "1"), source="a.pp")
    np.testing.assert_array_equal(found[:, 0], [3, np.nan, 1])
