"""Frames, the camera and the pixel convention; OpenCV is the judge."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from rpl_data import geometry as g
from rpl_data.types import DataError, Intrinsics

PLAIN = Intrinsics(600.0, 610.0, 320.5, 241.0, 640, 480)
BARREL = Intrinsics(600.0, 610.0, 320.5, 241.0, 640, 480, (-0.2, 0.05, 0.001, -0.002, 0.01))
RNG = np.random.default_rng(7)


def random_transform(rng: np.random.Generator) -> np.ndarray:
    return g.from_rotvec(rng.normal(size=3), rng.normal(size=3))


TRANSFORMS = [random_transform(RNG) for _ in range(4)] + [
    np.eye(4),
    g.from_rotvec(np.array([1e-9, 0, 0]), np.zeros(3)),
    g.from_rotvec(np.array([0, np.pi, 0]), np.ones(3)),
]


# Rigid transforms


@pytest.mark.parametrize("a_from_b", TRANSFORMS)
def test_inverse_and_composition(a_from_b: np.ndarray) -> None:
    points = RNG.normal(size=(5, 3))
    np.testing.assert_allclose(a_from_b @ g.invert(a_from_b), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(g.invert(a_from_b), np.linalg.inv(a_from_b), atol=1e-12)
    np.testing.assert_allclose(
        g.transform(g.invert(a_from_b), g.transform(a_from_b, points)), points, atol=1e-12
    )
    both = TRANSFORMS[0] @ a_from_b
    np.testing.assert_allclose(
        g.transform(both, points), g.transform(TRANSFORMS[0], g.transform(a_from_b, points))
    )


def test_a_stack_is_inverted_one_by_one() -> None:
    stack = np.array(TRANSFORMS).reshape(7, 1, 4, 4)
    np.testing.assert_allclose(g.invert(stack)[3, 0], g.invert(TRANSFORMS[3]))


@pytest.mark.parametrize("a_from_b", TRANSFORMS)
def test_quaternion_round_trip(a_from_b: np.ndarray) -> None:
    quaternion = g.to_quaternion_xyzw(a_from_b)
    assert quaternion[3] >= 0
    np.testing.assert_allclose(g.from_quaternion_xyzw(3 * quaternion, a_from_b[:3, 3]), a_from_b, atol=1e-12)


def test_quarter_turn_by_hand() -> None:
    """90 degrees about z takes x to y; xyzw = (0, 0, sqrt(1/2), sqrt(1/2))."""
    h = np.sqrt(0.5)
    turned = g.from_quaternion_xyzw(np.array([0, 0, h, h]), np.array([0, 0, 5.0]))
    np.testing.assert_allclose(g.transform(turned, np.array([[1.0, 0, 0]])), [[0, 1, 5]], atol=1e-12)
    assert g.rotation_angle_rad(turned[:3, :3]) == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(
        turned, g.from_rotvec(np.array([0, 0, np.pi / 2]), np.array([0, 0, 5.0])), atol=1e-12
    )


@pytest.mark.parametrize("quaternion", [[0, 0, 0, 0], [0, 0, np.nan, 1], [np.inf, 0, 0, 1]])
def test_a_quaternion_that_is_none_is_refused(quaternion: list[float]) -> None:
    with pytest.raises(DataError, match="expected finite numbers and a unit quaternion"):
        g.from_quaternion_xyzw(np.array(quaternion, dtype=float), np.zeros(3))


# Kabsch


@pytest.mark.parametrize("a_from_b", TRANSFORMS)
@pytest.mark.parametrize("flat", [False, True])
def test_kabsch_recovers_the_transform(a_from_b: np.ndarray, flat: bool) -> None:
    """Also for points in a plane, where the naive sign choice reflects half of the time."""
    points_b = RNG.normal(size=(6, 3)) * [1, 1, 0 if flat else 1]
    found = g.fit_rigid(g.transform(a_from_b, points_b), points_b)
    np.testing.assert_allclose(found, a_from_b, atol=1e-9)


def test_kabsch_is_proper_when_a_reflection_would_fit_better() -> None:
    points = RNG.normal(size=(8, 3))
    found = g.fit_rigid(points * [-1, 1, 1], points)
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1)


def test_kabsch_is_the_least_squares_optimum() -> None:
    """No small motion of the answer lowers the weighted cost."""
    points_b = RNG.normal(size=(7, 3))
    points_a = g.transform(TRANSFORMS[1], points_b) + 0.1 * RNG.normal(size=(7, 3))
    weights = RNG.uniform(0.1, 1, 7)

    def cost(a_from_b: np.ndarray) -> float:
        return float(weights @ ((g.transform(a_from_b, points_b) - points_a) ** 2).sum(axis=1))

    best = g.fit_rigid(points_a, points_b, weights)
    for _ in range(50):
        moved = g.from_rotvec(1e-3 * RNG.normal(size=3), 1e-3 * RNG.normal(size=3)) @ best
        assert cost(moved) > cost(best)


def test_kabsch_leaves_out_points_of_weight_zero() -> None:
    points_b = RNG.normal(size=(5, 3))
    points_a = g.transform(TRANSFORMS[2], points_b)
    points_a[4] += 1
    found = g.fit_rigid(points_a, points_b, np.array([1.0, 1, 1, 1, 0]))
    np.testing.assert_allclose(found, TRANSFORMS[2], atol=1e-9)


@pytest.mark.parametrize("points", [np.eye(3)[:2], np.outer(np.arange(5.0), [1, 2, 3]), np.zeros((4, 3))])
def test_points_on_a_line_are_refused(points: np.ndarray) -> None:
    with pytest.raises(DataError, match="at least 3 points that do not lie on a line"):
        g.fit_rigid(points, points)


def test_spread_by_hand() -> None:
    points = np.array([[2, 0, 0], [-2, 0, 0], [0, 1, 0], [0, -1, 0.0]])
    np.testing.assert_allclose(g.spread_m(points), [np.sqrt(2), np.sqrt(0.5), 0], atol=1e-12)
    np.testing.assert_array_equal(g.spread_m(np.empty((0, 3))), [0, 0, 0])
    np.testing.assert_allclose(g.spread_m(points[:1]), [0, 0, 0])


# The camera


@pytest.mark.parametrize("camera", [PLAIN, BARREL])
def test_projection_is_opencvs(camera: Intrinsics) -> None:
    points = RNG.uniform([-0.5, -0.4, 0.8], [0.5, 0.4, 2], size=(40, 3))
    expected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion)
    )
    np.testing.assert_allclose(g.project(camera, points), expected.reshape(-1, 2), atol=1e-9)


def test_projection_by_hand() -> None:
    """600 * 0.1 / 0.5 + 320.5 = 440.5; 610 * (-0.2) / 0.5 + 241 = -3, off the image but projected."""
    uv = g.project(PLAIN, np.array([[0.1, -0.2, 0.5], [0, 0, 1]]))
    np.testing.assert_allclose(uv, [[440.5, -3], [320.5, 241]])


@pytest.mark.parametrize("camera", [PLAIN, BARREL])
def test_points_behind_the_camera_never_project(camera: Intrinsics) -> None:
    points = np.array([[0, 0, -1], [0, 0, 0], [np.nan, 0, 1], [0, 0, np.nan], [0, 0, 1]])
    uv = g.project(camera, points)
    assert np.isnan(uv[:4]).all()
    np.testing.assert_allclose(uv[4], [camera.cx, camera.cy])
    assert g.project(camera, np.empty((0, 3))).shape == (0, 2)


@pytest.mark.parametrize("camera", [PLAIN, BARREL])
def test_back_projection_undoes_projection(camera: Intrinsics) -> None:
    uv = RNG.uniform([0, 0], [639, 479], size=(50, 2))
    depth_m = RNG.uniform(0.3, 3, 50)
    points = g.back_project(camera, uv, depth_m)
    np.testing.assert_allclose(points[:, 2], depth_m)
    np.testing.assert_allclose(g.project(camera, points), uv, atol=1e-6)
    assert g.rays(camera, np.empty((0, 2))).shape == (0, 3)


# Crop and resize


@pytest.mark.parametrize("camera", [PLAIN, BARREL])
@pytest.mark.parametrize("size", [(320, 240), (1280, 960), (256, 256)])
def test_resized_camera_by_opencvs_resize(camera: Intrinsics, size: tuple[int, int]) -> None:
    """A ramp image whose value is its own u (or v), resized, must hold the u of what it then shows."""
    width, height = size
    ramp = np.dstack(np.meshgrid(np.arange(640.0), np.arange(480.0)))
    small = cv2.resize(ramp, size, interpolation=cv2.INTER_LINEAR)
    pixels = np.array([[width // 2, height // 2], [width // 4, height // 3], [width - 20, 25]])
    before = np.array([small[v, u] for u, v in pixels])
    resized = g.resized(camera, width=width, height=height)
    np.testing.assert_allclose(g.rays(resized, pixels.astype(float)), g.rays(camera, before), atol=1e-6)


@pytest.mark.parametrize("camera", [PLAIN, BARREL])
def test_cropped_camera_sees_the_same_rays(camera: Intrinsics) -> None:
    cropped = g.cropped(camera, left_px=100, top_px=50, width=200, height=150)
    uv = np.array([[0.0, 0.0], [10.5, 20.25]])
    np.testing.assert_allclose(g.rays(cropped, uv), g.rays(camera, uv + [100, 50]), atol=1e-12)
    assert (cropped.width, cropped.height) == (200, 150)


# Pixels and boxes


def test_the_centre_of_the_first_pixel_is_the_origin() -> None:
    uv = np.array([[-0.5, -0.5], [639.4, 479.4], [639.5, 0], [0, 479.5], [-0.51, 0], [np.nan, 0]])
    assert g.inside_image(PLAIN, uv).tolist() == [True, True, False, False, False, False]


def test_a_mask_of_one_pixel_has_a_box_of_one_by_one() -> None:
    """COCO's edges, as pycocotools gives them: xywh (3, 2, 1, 1) for the pixel u = 3, v = 2."""
    from pycocotools import mask as coco

    image = np.zeros((6, 8), np.uint8, order="F")
    image[2, 3] = 1
    x, y, w, h = coco.toBbox(coco.encode(image))
    assert g.box_around(np.array([[3.0, 2.0]])) == (x, y, x + w, y + h) == (3, 2, 4, 3)
    image[2:5, 3:7] = 1
    x, y, w, h = coco.toBbox(coco.encode(image))
    assert g.box_around(np.argwhere(image)[:, ::-1].astype(float)) == (x, y, x + w, y + h)


def test_square_box_by_hand() -> None:
    """Keypoints span 40 x 20 px around (30, 50): side 1.5 x 40."""
    box = g.square_box(np.array([[10.0, 40.0], [50.0, 60.0], [30.0, 45.0]]))
    assert (box.cx_px, box.cy_px, box.side_px) == (30, 50, 60)


def test_depth_noise_grows_with_the_square_of_the_distance() -> None:
    assert g.depth_sigma_m(0.7) == pytest.approx(1.5e-3)
    assert g.depth_sigma_m(1.4) == pytest.approx(6e-3)
