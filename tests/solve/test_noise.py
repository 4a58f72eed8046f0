"""The noise that residuals show, and whether the stated covariances are those of the errors."""

import numpy as np
import pytest
from clicked_scenes import CUBE, NAMES, cameras, click_scene, pose
from scipy.spatial.transform import Rotation

from rpl_data.geometry import fit_rigid, invert, rigid, transform
from rpl_data.solve.bundle_adjustment import State, linearise, moved
from rpl_data.solve.click_rays import Noise, misfit, rays_of
from rpl_data.solve.noise import (
    estimate_noise,
    joint_covariance,
    points_in_scene_covariance,
    shape_covariance,
    widened_for_all_scenes,
)
from rpl_data.solve.solve import register_scene, solve, solve_unchecked
from rpl_data.solve.straying import without_straying
from rpl_data.types import KeypointModel

DEPTH_SIGMA_M = 0.0025


def noisy_scenes(random, count, noise_px, clicks=1):
    """Scenes with clicks and depths as uncertain as they are said to be, and where the object stands."""
    truth = {f"{s:02d}": pose(random) for s in range(count)}
    observations = []
    for name, at in truth.items():
        observations += click_scene(
            name, CUBE, at, cameras(clicks), random, noise_px=noise_px,
            depths=lambda k, f, z: [z + random.normal(0, DEPTH_SIGMA_M)],
        )  # fmt: skip
    return truth, observations


@pytest.mark.parametrize("noise_px", [1.0, 2.0, 4.0])
def test_the_click_noise_is_found(noise_px):
    random = np.random.default_rng(1)
    found = [solve("cube", NAMES, noisy_scenes(random, 5, noise_px)[1]).click_sigma_px for _ in range(5)]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(noise_px, rel=0.15)


@pytest.mark.parametrize(("noise_px", "clicks"), [(1.0, 1), (4.0, 1), (2.0, 3)])
def test_errors_in_the_scene_are_as_large_as_stated(noise_px, clicks):
    random = np.random.default_rng(2)
    ratios = []
    for _ in range(5):
        truth, observations = noisy_scenes(random, 4, noise_px, clicks)
        solution = solve("cube", NAMES, observations)
        for name, at in truth.items():
            errors = transform(solution.scene_from_object[name], solution.model.points_object) - transform(
                at, CUBE
            )
            inverse = np.linalg.inv(solution.covariance_in_scene[name])
            ratios.append(np.einsum("ki,kij,kj->k", errors, inverse, errors) / 3)
    assert 0.8 < np.sqrt(np.mean(ratios)) < 1.25


@pytest.mark.parametrize("keypoints", [[0, 3, 5], [0, 1, 3, 6], [0, 1, 2, 4, 5, 7]])
def test_errors_in_a_new_scene_are_as_large_as_stated(keypoints):
    """With an uncertain model: its errors and those of the new clicks together."""
    random = np.random.default_rng(3)
    ratios = []
    for _ in range(25):
        at = pose(random)
        errors = random.normal(0, 0.002, CUBE.shape)
        model = KeypointModel("cube", NAMES, CUBE + errors)
        observations = click_scene(
            "new", CUBE, at, cameras(1), random, noise_px=2.0, keypoints=keypoints,
            depths=lambda k, f, z: [z + random.normal(0, DEPTH_SIGMA_M)],
        )  # fmt: skip
        found = register_scene(
            model, observations, covariance=np.tile(0.002**2 * np.eye(3), (8, 1, 1)), click_sigma_px=2.0
        )
        wrong = transform(found.scene_from_object, model.points_object) - transform(at, CUBE)
        inverse = np.linalg.inv(found.covariance_in_scene)
        ratios.append(np.einsum("ki,kij,kj->k", wrong, inverse, wrong) / 3)
    assert 0.75 < np.sqrt(np.mean(ratios)) < 1.3


def test_a_straying_trajectory_widens_the_covariance_in_its_scene_only():
    _, observations = noisy_scenes(np.random.default_rng(4), 3, 2.0)
    still = solve("cube", NAMES, observations)
    stray = solve("cube", NAMES, observations, trajectory_sigma_m={"01": 0.003})
    wider = {name: stray.covariance_in_scene[name] - still.covariance_in_scene[name] for name in ("00", "01")}
    np.testing.assert_allclose(wider["00"], 0, atol=1e-12)
    np.testing.assert_allclose(wider["01"], np.tile(9e-6 * np.eye(3), (8, 1, 1)), atol=1e-12)


def test_the_covariance_of_the_scene_is_turned_to_the_axes_of_the_object():
    _, observations = noisy_scenes(np.random.default_rng(5), 3, 2.0)
    solution = solve("cube", NAMES, observations)
    turn = solution.scene_from_object["02"][:3, :3]
    turned = solution.covariance_at("02")
    np.testing.assert_allclose(turn @ turned @ turn.T, solution.covariance_in_scene["02"], atol=1e-15)
    assert solution.covariance_at("02") is not solution.covariance
    older = type(solution)(solution.model, solution.covariance, solution.scene_from_object)
    assert older.covariance_at("02") is solution.covariance


def test_covariances_do_not_depend_on_the_frame_of_the_model():
    _, observations = noisy_scenes(np.random.default_rng(6), 3, 1.0)
    rays = rays_of(observations, ["00", "01", "02"])
    solution = solve("cube", NAMES, observations)
    state = State(np.stack(list(solution.scene_from_object.values())), solution.model.points_object)
    by = pose(np.random.default_rng(7))
    other = State(state.scene_from_model @ invert(by), transform(by, state.points_model))
    known = np.ones(8, dtype=bool)
    one, two = (joint_covariance(rays, s, noise=Noise()) for s in (state, other))
    np.testing.assert_allclose(
        points_in_scene_covariance(one, state, 1, known),
        points_in_scene_covariance(two, other, 1, known),
        rtol=1e-4,
    )
    turn = by[:3, :3]
    np.testing.assert_allclose(
        turn @ shape_covariance(one, state, known) @ turn.T,
        shape_covariance(two, other, known),
        rtol=1e-4,
        atol=1e-12,
    )


def test_derivatives_are_those_of_differences():
    """With slanted surfaces, whose depth changes with the keypoint's pixel."""
    random = np.random.default_rng(8)
    _, observations = noisy_scenes(random, 2, 2.0)
    rays = rays_of(observations, ["00", "01"])
    rays = rays._replace(depth_slopes_m=random.normal(0, 0.8, rays.depth_slopes_m.shape))
    solution = solve("cube", NAMES, observations)
    state = State(np.stack(list(solution.scene_from_object.values())), solution.model.points_object)
    system = linearise(rays, state, noise=Noise())
    for unknown in (0, 5, 7, 12 + 3, 12 + 22):
        step = np.zeros(system.jacobian.shape[2])
        step[unknown] = 1e-6
        ahead, behind = (linearise(rays, moved(state, s), noise=Noise()).residual for s in (step, -step))
        np.testing.assert_allclose(
            system.jacobian[..., unknown], (ahead - behind) / 2e-6, rtol=1e-4, atol=1e-3
        )


def test_a_keypoint_beside_its_click_on_a_slanted_plane_has_no_depth_error():
    """Plane z = 0.7 + x; the keypoint lies on it 3 px beside the click."""
    point = np.array([0.0035 / (1 - 0.0035 / 0.7), 0.0, 0.0])
    point[2] = 0.7 + point[0]
    observation = click_scene("00", point[None], np.eye(4), [np.eye(4)], np.random.default_rng(0))[0]
    observation = type(observation)(
        observation.click, np.array([0.0, 0.0, 1.0]), np.eye(4), np.array([0.7]), np.array([0.002]), 1 / 600,
        np.array([[0.7, 0.0]]),
    )  # fmt: skip
    found = misfit(rays_of([observation], ["00"]), point[None])
    assert found.depth_error_m == pytest.approx(0, abs=1e-12)
    assert found.error_px[0] == pytest.approx([3.0, 0.0])


@pytest.mark.parametrize(("spread_rad", "remains"), [(0.0, 2.8 / 3), (3.0, 1 / 3)])
def test_clicks_that_share_an_error_weigh_as_one_for_that_share(spread_rad, remains):
    """Three clicks in the same view share 0.9 of their variance, and in the mean 0.1 / 3 + 0.9 remains.

    From three sides they share nothing.
    """
    observations = click_scene(
        "00", CUBE, pose(np.random.default_rng(9)), cameras(3, spread_rad), np.random.default_rng(9)
    )
    sigmas = rays_of(observations, ["00"]).depth_sigmas_m[:, 0]
    assert sigmas**2 / 3 == pytest.approx(DEPTH_SIGMA_M**2 * remains, rel=0.02)


def test_clicks_without_depth_share_no_error_of_a_depth():
    """Three clicks in the same view of which the first alone has a depth: that one counts in full."""
    at, random = pose(np.random.default_rng(9)), np.random.default_rng(9)
    observations = click_scene(
        "00", CUBE, at, cameras(3, 0.0), random, depths=lambda k, f, z: [z] if f == 0 else []
    )
    rays = rays_of(observations, ["00"])
    for found in (rays, widened_for_all_scenes(rays, State(at[None], CUBE))):
        np.testing.assert_allclose(found.depth_sigmas_m[:8, 0], DEPTH_SIGMA_M)
        assert np.isnan(found.depth_sigmas_m[8:, 0]).all() and (found.widening == 1).all()


def test_scenes_that_see_a_keypoint_from_nearly_the_same_side_share_its_error():
    """It is turned by 40 degrees about an axis across the line of sight: 0.5 exp(-(40 / 25)^2 / 2)."""
    at = pose(np.random.default_rng(9))
    across = np.cross(at[2, :3], [0.3, 0.5, 0.8])  # the camera looks along z
    turn = rigid(
        Rotation.from_rotvec(np.deg2rad(40) * across / np.linalg.norm(across)).as_matrix(), np.zeros(3)
    )
    poses, middle = np.stack([at, at @ turn]), np.zeros((1, 3))
    observations = [
        o
        for name, one in zip(("00", "01"), poses, strict=True)
        for o in click_scene(name, middle, one, cameras(1), np.random.default_rng(9))
    ]
    rays = rays_of(observations, ["00", "01"])
    assert (rays.widening == 1).all(), "scene by scene they share nothing"
    shared = 0.5 * np.exp(-((2 * np.sin(np.deg2rad(20))) ** 2) / (2 * np.deg2rad(25) ** 2))
    found = widened_for_all_scenes(rays, State(poses, middle)).depth_sigmas_m[:, 0]
    np.testing.assert_allclose(found, DEPTH_SIGMA_M * np.sqrt(1 + shared), rtol=1e-6)


def test_depths_that_share_an_error_count_for_the_noise_as_often_as_they_were_measured():
    """Four keypoints have depths in three frames of one view, 1 sigma off; four in one frame, 2 sigmas off.

    The adjustment takes the former for sqrt(2.8) times as uncertain, and weighs them by that, but each counts
    as one of the others. At the truth, with a prior of 3 residuals of 1:
    """
    at = pose(np.random.default_rng(9))
    observations = click_scene(
        "00", CUBE, at, cameras(3, 0.0), np.random.default_rng(9),
        depths=lambda k, f, z: [z + (1 if k < 4 else 2) * DEPTH_SIGMA_M] if k < 4 or f == 0 else [],
    )  # fmt: skip
    rays, prior = rays_of(observations, ["00"]), Noise(2.0, 1.0)
    found = estimate_noise(rays, State(at[None], CUBE), noise=Noise(0.1, 1.0), prior=prior, hold_points=True)
    often, once = 12 * (1 + 1 / 2.8 / 9) ** -2, 4 * (1 + 4 / 9) ** -2  # sums of weights
    by_hand = (3 + (often * 1 + once * 4) / 0.733) / (3 + often + once)
    assert found.depth_ratio**2 == pytest.approx(by_hand, rel=0.02)


def scenes_from_one_side(random, depth_ratio):
    """Four scenes that see the object in the same view; their depths share 0.9 of their variance."""
    front = pose(np.random.default_rng(10))
    shared = random.normal(0, np.sqrt(0.9), len(CUBE))
    truth, observations = {}, []
    for s in range(4):
        turn = rigid(Rotation.from_rotvec(random.normal(0, 0.01, 3)).as_matrix(), np.zeros(3))
        truth[f"{s:02d}"] = front @ turn
        observations += click_scene(
            f"{s:02d}", CUBE, front @ turn, cameras(1), random, noise_px=1.5,
            depths=lambda k, f, z: [
                z + depth_ratio * DEPTH_SIGMA_M * (shared[k] + random.normal(0, np.sqrt(0.1)))
            ],
        )  # fmt: skip
    return truth, observations


@pytest.mark.parametrize(("depth_ratio", "least", "most_found"), [(1.0, 0.6, 2.0), (2.0, 0.8, 1.3)])
def test_the_covariance_holds_where_all_clicks_err_together(depth_ratio, least, most_found):
    """Clicks in one view hardly show the ratio, so the usual one, 2, counts: better ones are stated worse."""
    random = np.random.default_rng(11)
    ratios, found = [], []
    for _ in range(8):
        _, observations = scenes_from_one_side(random, depth_ratio)
        solution = solve_unchecked("cube", NAMES, observations).solution
        moved_back = transform(fit_rigid(CUBE, solution.model.points_object), solution.model.points_object)
        stated = np.trace(solution.covariance, axis1=1, axis2=2).mean()
        ratios.append(((moved_back - CUBE) ** 2).sum(axis=1).mean() / stated)
        found.append(solution.depth_sigma_ratio)
    assert least < np.sqrt(np.mean(ratios)) < 1.25
    assert 0.8 < np.mean(found) / depth_ratio < most_found


def test_what_the_clicks_of_a_straying_frame_share_is_eliminated():
    """Against generalised least squares written out: covariance 1 + s^2 B B' within each frame."""
    random = np.random.default_rng(12)
    by_shift, residual = random.normal(0, 300, (5, 3, 3)), random.normal(0, 1, (5, 3))
    frame, strayed_m = np.array([0, 1, 0, 1, 2]), np.array([0.003, 0.002, 0.003, 0.002, 0.0])
    unit = np.eye(15).reshape(5, 3, 15)
    found = without_straying(residual, unit, by_shift, strayed_m, frame)
    rows = by_shift.reshape(15, 3)
    same = np.repeat(np.repeat(frame[:, None] == frame, 3, axis=0), 3, axis=1)
    covariance = np.eye(15) + np.repeat(strayed_m, 3)[:, None] ** 2 * (rows @ rows.T) * same
    whitening = found.jacobian.reshape(15, 15)
    np.testing.assert_allclose(whitening @ covariance @ whitening.T, np.eye(15), atol=1e-9)
    np.testing.assert_allclose(found.residual.ravel(), whitening @ residual.ravel(), atol=1e-12)
    assert found.relief == pytest.approx((residual**2).sum() - (found.residual**2).sum())
    np.testing.assert_array_equal(found.residual[4], residual[4])
