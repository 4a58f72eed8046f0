"""Pose from keypoints: exactness, wrong keypoints, weights, depth, and what is refused."""

from __future__ import annotations

from itertools import combinations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpl_data.geometry import invert, project, rays, rigid, rotation_angle_rad, transform
from rpl_data.pose import correspondences
from rpl_data.pose.depth import depths_at
from rpl_data.pose.errors import INFINITE, pose_errors
from rpl_data.pose.estimate import PoseEstimate, PoseFailure, estimate_pose
from rpl_data.pose.minimize import move, write_normal_equations
from rpl_data.pose.p3p import poses_from_triples
from rpl_data.pose.quartic import quartic_roots
from rpl_data.pose.refine import covariance_of, nearest_to_depth, refined, with_own_depth
from rpl_data.types import Intrinsics

CAMERA = Intrinsics(585.0, 580.0, 320.5, 238.0, 640, 480)
LENS = Intrinsics(585.0, 580.0, 320.5, 238.0, 640, 480, (0.08, -0.15, 0.001, -0.0005))
METHODS = ["epnp", "sqpnp", "ransac", "consensus"]


def some_pose(seed: int) -> tuple[np.random.Generator, np.ndarray, np.ndarray]:
    """A generator, 8 points of a 0.2 m object, and where it stands."""
    rng = np.random.default_rng(seed)
    at = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.5, 1.0)])
    return rng, rng.uniform(-0.1, 0.1, (8, 3)), rigid(Rotation.random(rng=rng).as_matrix(), at)


def seen(pose: np.ndarray, points: np.ndarray, camera: Intrinsics = CAMERA) -> np.ndarray:
    return project(camera, transform(pose, points))


def is_near(
    found: PoseEstimate | PoseFailure, pose: np.ndarray, *, deg: float = 5.0, m: float = 0.03
) -> bool:
    if isinstance(found, PoseFailure):
        return False
    turned = np.degrees(rotation_angle_rad(found.camera_from_object[:3, :3].T @ pose[:3, :3]))
    return turned < deg and np.linalg.norm(found.camera_from_object[:3, 3] - pose[:3, 3]) < m


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("camera", [CAMERA, LENS], ids=["pinhole", "lens"])
def test_noise_free_is_exact(method, camera):
    for seed in range(10):
        _, points, pose = some_pose(seed)
        found = estimate_pose(correspondences(points, seen(pose, points, camera), camera), method=method)
        np.testing.assert_allclose(found.camera_from_object, pose, atol=1e-6)
        assert found.keypoints.tolist() == list(range(8)) and found.error_sigmas < 1e-4


def test_another_object_frame_is_the_same_pose():
    rng, points, pose = some_pose(3)
    pixels = seen(pose, points) + rng.normal(0, 2, (8, 2))
    a_from_b = rigid(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    here = estimate_pose(correspondences(points, pixels, CAMERA))
    there = estimate_pose(correspondences(transform(a_from_b, points), pixels, CAMERA))
    np.testing.assert_allclose(there.camera_from_object @ a_from_b, here.camera_from_object, atol=2e-4)


@pytest.mark.parametrize("wrong", [1, 2, 3])
def test_wrong_keypoints_are_left_out(wrong):
    good = 0
    for seed in range(60):
        rng, points, pose = some_pose(seed)
        pixels = seen(pose, points) + rng.normal(0, 1, (8, 2))
        bad = rng.permutation(8)[:wrong]
        pixels[bad] += rng.uniform(20, 80, (wrong, 2)) * rng.choice([-1, 1], (wrong, 2))
        found = estimate_pose(correspondences(points, pixels, CAMERA))
        if is_near(found, pose):
            good += 1
            assert not set(bad.tolist()) & set(found.keypoints.tolist())
    assert good >= {1: 57, 2: 55, 3: 42}[wrong]


def test_more_than_ten_keypoints():
    rng, _, pose = some_pose(1)
    points = rng.uniform(-0.1, 0.1, (16, 3))
    pixels = seen(pose, points) + rng.normal(0, 1, (16, 2))
    pixels[:5] += 50
    found = estimate_pose(correspondences(points, pixels, CAMERA))
    assert is_near(found, pose, deg=2.0) and found.keypoints.min() == 5


def test_refinement_trusts_what_is_certain():
    plain, weighted = [], []
    for seed in range(40):
        rng, points, pose = some_pose(seed)
        sigma = rng.choice([0.5, 6.0], (8, 2))
        pixels = seen(pose, points) + rng.normal(0, 1, (8, 2)) * sigma
        covariance = np.array([np.diag(row**2) for row in sigma])
        for errors, given in (
            (plain, correspondences(points, pixels, CAMERA)),
            (weighted, correspondences(points, pixels, CAMERA, covariance_px=covariance)),
        ):
            found = estimate_pose(given, method="sqpnp").camera_from_object
            errors.append(np.linalg.norm(found[:3, 3] - pose[:3, 3]))
    assert np.median(weighted) < 0.6 * np.median(plain)


def test_covariance_is_that_of_the_estimates():
    rng, points, pose = some_pose(5)
    covariance_px = np.array([[4.0, 1.5], [1.5, 1.0]])
    given = correspondences(
        points, seen(pose, points), CAMERA, covariance_px=np.tile(covariance_px, (8, 1, 1))
    )
    expected = covariance_of(pose, given)
    off = []
    for _ in range(400):
        pixels = seen(pose, points) + rng.multivariate_normal(np.zeros(2), covariance_px, 8)
        noisy = correspondences(points, pixels, CAMERA, covariance_px=np.tile(covariance_px, (8, 1, 1)))
        found = refined(pose, noisy, robust=False)
        turn = Rotation.from_matrix(found[:3, :3] @ pose[:3, :3].T).as_rotvec()
        off.append([*turn, *(found[:3, 3] - pose[:3, 3])])
    distances = np.einsum("ni,ij,nj->n", off, np.linalg.inv(expected), off)
    assert np.mean(distances) == pytest.approx(6, rel=0.15)  # chi-squared of 6 degrees of freedom


def test_depth_pins_the_distance():
    without, with_depth = [], []
    for seed in range(40):
        rng, points, pose = some_pose(seed)
        pixels = seen(pose, points) + rng.normal(0, 2, (8, 2))
        depth = transform(pose, points)[:, 2] + rng.normal(0, 0.002, 8)
        depth[:3] = np.nan
        depth[3] += 0.2  # that of the wall behind
        for errors, given in (
            (without, correspondences(points, pixels, CAMERA)),
            (
                with_depth,
                correspondences(points, pixels, CAMERA, depth_m=depth, depth_sigma_m=np.full(8, 0.002)),
            ),
        ):
            found = estimate_pose(given, method="sqpnp").camera_from_object
            errors.append(abs(found[2, 3] - pose[2, 3]))
    assert np.median(with_depth) < 0.4 * np.median(without)


# Refusals -----------------------------------------------------------------------------------------


def test_what_cannot_be_solved_says_why():
    rng, points, pose = some_pose(0)
    line = np.outer(np.linspace(-1, 1, 8), [0.1, 0.05, 0.0])
    plane = np.column_stack([rng.uniform(-0.1, 0.1, (8, 2)), np.zeros(8)])
    for model, reason in ((line, "keypoints on a line"), (plane, "keypoints in a plane")):
        for method in METHODS:
            found = estimate_pose(correspondences(model, seen(pose, model), CAMERA), method=method)
            assert found == PoseFailure(reason)
    few = seen(pose, points)
    few[3:] = np.nan
    assert estimate_pose(correspondences(points, few, CAMERA)) == PoseFailure("too few keypoints")
    unknown = np.full((8, 3), np.nan)
    assert estimate_pose(correspondences(unknown, seen(pose, points), CAMERA)) == PoseFailure(
        "too few keypoints"
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("refine", [True, False])
@pytest.mark.parametrize("together", [5, 7, 8])
def test_keypoints_in_one_place_are_no_pose(method, refine, together):
    for seed in range(4):
        rng, points, pose = some_pose(seed)
        pixels = seen(pose, points)
        pixels[:together] = pixels[0] + rng.normal(0, 0.1, (together, 2))
        found = estimate_pose(correspondences(points, pixels, CAMERA), method=method, refine=refine)
        assert found == PoseFailure("keypoints coincide")


@pytest.mark.parametrize("method", METHODS)
def test_an_object_smaller_than_its_noise_is_no_pose(method):
    rng, points, _ = some_pose(1)
    pixels = 200 + rng.normal(0, 2, (8, 2))
    found = estimate_pose(correspondences(points, pixels, CAMERA), method=method)
    assert found == PoseFailure("keypoints coincide")


@pytest.mark.parametrize("method", METHODS)
def test_no_method_raises_or_returns_what_cannot_be(method):
    for seed in range(10):
        rng, points, pose = some_pose(seed)
        pixels = seen(pose, points)
        for wrong in (
            pixels * 1e12,
            rng.permutation(pixels),
            np.column_stack([pixels[:, 0], np.full(8, 240.0)]),
            2 * pixels.mean(axis=0) - pixels,
        ):
            found = estimate_pose(correspondences(points, wrong, CAMERA), method=method)
            if isinstance(found, PoseEstimate):
                assert (transform(found.camera_from_object, points[found.keypoints])[:, 2] > 0).all()
                off = seen(found.camera_from_object, points[found.keypoints]) - wrong[found.keypoints]
                assert np.sqrt((off**2).mean()) < np.sqrt(wrong.var(axis=0).mean())


def test_noise_alone_is_no_pose():
    found = []
    for seed in range(30):
        rng, points, _ = some_pose(seed)
        pixels = rng.uniform(0, 1, (8, 2)) * [640, 480]
        found.append(estimate_pose(correspondences(points, pixels, CAMERA)))
    refused = [each for each in found if isinstance(each, PoseFailure)]
    assert len(refused) >= 24
    assert not any(np.allclose(each.camera_from_object, np.eye(4)) for each in found if each not in refused)


# Parts --------------------------------------------------------------------------------------------


def test_every_triple_holds_the_pose():
    _, points, pose = some_pose(7)
    triples = np.array(list(combinations(range(8), 3)))
    directions = rays(CAMERA, seen(pose, points))
    found = poses_from_triples(points[triples], directions[triples])
    near = np.abs(found - pose).max(axis=(1, 2)) < 1e-5
    assert near.sum() >= 54  # a double root may cost one or two of 56 their digits
    turns = found[:, :3, :3]
    products = turns @ np.swapaxes(turns, 1, 2)
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(3), products.shape), atol=1e-9)


def test_triples_against_opencv():
    """Every pose that OpenCV finds for three points is found, also where noise moves them."""
    rng = np.random.default_rng(0)
    for _ in range(40):
        at = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.5, 1.0)])
        points, pose = rng.uniform(-0.1, 0.1, (3, 3)), rigid(Rotation.random(rng=rng).as_matrix(), at)
        seen_at = project(CAMERA, transform(pose, points)) + rng.normal(0, 2, (3, 2))
        found = poses_from_triples(points[None], rays(CAMERA, seen_at)[None])
        _, rotvecs, shifts = cv2.solveP3P(points, seen_at, CAMERA.matrix, None, flags=cv2.SOLVEPNP_AP3P)
        for rotvec, shift in zip(rotvecs, shifts, strict=True):
            other = rigid(cv2.Rodrigues(rotvec)[0], shift[:, 0])
            if np.abs(project(CAMERA, transform(other, points)) - seen_at).max() < 1e-3:
                assert np.abs(found - other).max(axis=(1, 2)).min() < 1e-4


def test_degenerate_triples_are_left_out_or_finite():
    _, points, pose = some_pose(2)
    coincident = np.array([points[0], points[1], points[0]])
    line = np.array([points[0], (points[0] + points[1]) / 2, points[1]])
    for three in (coincident, line, np.zeros((3, 3)), np.full((3, 3), np.nan), 1e200 * points[:3]):
        for directions in (rays(CAMERA, seen(pose, points[:3])), np.tile([0.1, 0.2, 1.0], (3, 1))):
            found = poses_from_triples(three[None], directions[None])
            assert found.shape[1:] == (4, 4) and np.isfinite(found).all()
    assert len(poses_from_triples(coincident[None], rays(CAMERA, seen(pose, points[:3]))[None])) == 0


def test_quartics_against_numpy():
    coefficients = np.random.default_rng(0).normal(size=(5, 100))
    for column in coefficients.T:
        found = np.sort(quartic_roots(*column.tolist()))
        np.testing.assert_allclose(found, np.sort(np.roots(column[::-1]).real), atol=1e-6)


@pytest.mark.parametrize("roots", [(0, 0, 0, 0), (1, 1, 1, 1), (0, 0, 0, 4), (-1, -1, 3, 3), (-2, 0, 0, 2)])
def test_quartics_whose_roots_coincide(roots):
    assert np.sort(quartic_roots(*np.poly(roots)[::-1].tolist())) == pytest.approx(roots, abs=1e-4)


@pytest.mark.parametrize("robust", [False, True])
def test_the_slope_is_that_of_the_cost(robust):
    """By differences, along each of the six directions of a step, with and without depth."""
    rng, points, pose = some_pose(6)
    depth = transform(pose, points)[:, 2] + rng.normal(0, 0.02, 8)
    depth[:3] = np.nan
    whitening = np.tile([[0.5, 0.0], [0.2, 0.7]], (8, 1, 1))
    focal = np.array([CAMERA.fx, CAMERA.fy])
    given = (points, rng.normal(0, 20, (8, 2)), focal, whitening, depth, np.full(8, 0.01))
    normal, slope, moved = np.empty((6, 6)), np.empty(6), pose.copy()
    write_normal_equations(pose, given, robust, normal, slope)
    for k, direction in enumerate(1e-6 * np.eye(6)):
        costs = []
        for step in (direction, -direction):
            move(pose, step, moved)
            costs.append(write_normal_equations(moved, given, robust, np.empty((6, 6)), np.empty(6)))
        assert (costs[0] - costs[1]) / 2e-6 == pytest.approx(2 * slope[k], rel=1e-4, abs=1e-3)


def test_steps_turn_poses():
    rng, _, pose = some_pose(0)
    moved = pose.copy()
    for size in (1e-3, 1.0, 1e3):
        step = size * rng.normal(size=6)
        move(pose, step, moved)
        np.testing.assert_allclose(moved[:3, :3] @ moved[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(moved[:3, 3], pose[:3, 3] + step[3:])
        if size < 0.01:
            turn = Rotation.from_rotvec(step[:3]).as_matrix()
            np.testing.assert_allclose(moved[:3, :3], turn @ pose[:3, :3], atol=1e-9)


def test_depth_brings_back_a_pose_that_keypoints_alone_put_far_away():
    """Keypoints off by 12 px; a third of the depths are of what hides the keypoint."""
    without, with_depth = [], []
    for seed in range(30):
        rng, points, pose = some_pose(seed)
        points = 0.6 * points  # a small object's distance is the least known
        pixels = seen(pose, points) + rng.normal(0, 12, (8, 2))
        covariance = np.tile(144.0 * np.eye(2), (8, 1, 1))
        depth = transform(pose, points)[:, 2] + rng.normal(0, 0.01, 8)
        depth[:3] -= 0.09
        known = {"depth_m": depth, "depth_sigma_m": np.full(8, 0.012)}
        for off, more in ((without, {}), (with_depth, known)):
            found = estimate_pose(correspondences(points, pixels, CAMERA, covariance_px=covariance, **more))
            if isinstance(found, PoseEstimate):
                off.append(np.linalg.norm(found.camera_from_object[:3, 3] - pose[:3, 3]))
    assert len(with_depth) >= len(without) - 3
    assert np.median(with_depth) < 0.4 * np.median(without)


def test_depths_that_are_not_a_keypoints_own():
    _, points, pose = some_pose(5)
    depth = transform(pose, points)[:, 2]
    depth[[1, 4]] += [-0.09, 0.13]
    depth[6] = np.nan
    given = correspondences(
        points, seen(pose, points), CAMERA, depth_m=depth, depth_sigma_m=np.full(8, 0.005)
    )
    far = pose.copy()
    far[:3, 3] *= 1.3
    np.testing.assert_allclose(nearest_to_depth(far, given), pose, atol=0.03)
    kept = with_own_depth(pose, given, largest_sigmas=4.0)
    assert np.flatnonzero(np.isfinite(kept.depth_m)).tolist() == [0, 2, 3, 5, 7]
    # A depth of another surface tells nothing, so it must not make the pose look more certain.
    assert covariance_of(pose, kept)[5, 5] > covariance_of(pose, given)[5, 5]


def test_depth_about_a_keypoint():
    depth = np.zeros((20, 30), dtype=np.float32)
    depth[:, 10:] = 1.0  # the wall
    depth[5:15, 12:20] = 0.7  # the object, whose corner is at (12, 5)
    depth[10, 15] = 0.3  # a speck
    keypoints = np.array([[12.0, 5.0], [15.4, 10.2], [2.0, 2.0], [25.0, 10.0], [np.nan, 1.0], [31.0, 2.0]])
    np.testing.assert_allclose(
        depths_at(depth, keypoints), [0.7, 0.7, np.nan, 1.0, np.nan, np.nan], atol=1e-6
    )


def test_errors_by_hand():
    true = rigid(np.eye(3), np.array([0.0, 0, 1]))
    half_turn = rigid(np.diag([-1.0, -1, 1]), np.array([0.0, 0.01, 1]))
    points = np.array([[0.1, 0, 0], [-0.1, 0, 0]])  # looks the same after half a turn
    errors = pose_errors(half_turn, true, points, centre_object=np.zeros(3))
    assert errors.position_m == pytest.approx(0.01)
    assert errors.orientation_rad == pytest.approx(np.pi)
    assert errors.add_m == pytest.approx(np.hypot(0.2, 0.01))
    assert errors.adds_m == pytest.approx(0.01)
    far = pose_errors(half_turn, true, points, centre_object=np.array([0.1, 0, 0]))
    assert far.position_m == pytest.approx(np.hypot(0.2, 0.01))
    assert set(vars(INFINITE).values()) == {np.inf}


def test_errors_do_not_depend_on_the_camera():
    rng, points, pose = some_pose(2)
    other = pose @ rigid(Rotation.from_rotvec([0.02, 0, 0.01]).as_matrix(), np.array([0.001, 0.002, 0]))
    camera = rigid(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    centre = points.mean(axis=0)
    here = pose_errors(other, pose, points, centre_object=centre)
    there = pose_errors(invert(camera) @ other, invert(camera) @ pose, points, centre_object=centre)
    assert here.position_m == pytest.approx(there.position_m)
    assert here.orientation_rad == pytest.approx(there.orientation_rad)
    assert (here.add_m, here.adds_m) == pytest.approx((there.add_m, there.adds_m))


@pytest.mark.parametrize("none", [np.zeros((2, 2)), -np.eye(2), np.ones((2, 2)), np.full((2, 2), np.nan)])
def test_a_covariance_that_is_none_excludes_its_keypoint(none):
    """As of a heatmap that collapsed onto one pixel."""
    _, points, pose = some_pose(4)
    covariances = np.tile(np.eye(2), (8, 1, 1))
    covariances[2] = none
    found = estimate_pose(correspondences(points, seen(pose, points), CAMERA, covariance_px=covariances))
    assert found.keypoints.tolist() == [0, 1, 3, 4, 5, 6, 7]
    lost = correspondences(points, seen(pose, points), CAMERA, covariance_px=np.tile(none, (8, 1, 1)))
    assert [estimate_pose(lost, method=method).reason for method in METHODS] == ["too few keypoints"] * 4
