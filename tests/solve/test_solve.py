"""The sparse solve: exact without noise, robust with wrong clicks, honest about loose scenes."""

import numpy as np
import pytest
from clicked_scenes import CUBE, NAMES, cameras, click_scene, pose
from scipy.spatial.transform import Rotation

from rpl_data.geometry import fit_rigid, invert, rotation_angle_rad, transform
from rpl_data.solve.compiled_eq2 import _fit, alternate
from rpl_data.solve.initial_guess import join_clean
from rpl_data.solve.procrustes import (
    MOST_ALTERNATIONS,
    Fragments,
    adjust_points,
    alternate_by_svd,
    best_of_starts,
    eq2_cost,
    kabsch_stack,
)
from rpl_data.solve.solve import register, solve, solve_points
from rpl_data.types import Click, DataError, KeypointModel, Observation


def error_mm(points):
    known = np.isfinite(points).all(axis=1)
    fit = fit_rigid(CUBE[known], points[known])
    return 1e3 * np.linalg.norm(transform(fit, points[known]) - CUBE[known], axis=1)


def two_scenes(**options):
    random = np.random.default_rng(1)
    truth = {"00": pose(random), "01": pose(random)}
    observations = [
        o for name, at in truth.items() for o in click_scene(name, CUBE, at, cameras(3), random, **options)
    ]
    return truth, observations


@pytest.mark.parametrize("method", ["robust", "slsqp"])
def test_exact_without_noise(method):
    truth, observations = two_scenes()
    solution = solve("cube", NAMES, observations, method=method)
    assert error_mm(solution.model.points_object).max() < (1e-3 if method == "robust" else 0.2)
    assert np.allclose(solution.model.points_object.mean(axis=0), 0, atol=1e-9)
    between = solution.scene_from_object["01"] @ invert(solution.scene_from_object["00"])
    expected = truth["01"] @ invert(truth["00"])
    assert rotation_angle_rad(between[:3, :3] @ expected[:3, :3].T) < 3e-3
    assert not any(r.outlier for r in solution.residuals)


def test_object_frame_has_the_axes_of_the_first_scene():
    _, observations = two_scenes()
    assert np.allclose(
        solve("cube", NAMES, observations).scene_from_object["00"][:3, :3], np.eye(3), atol=1e-9
    )


def test_moving_all_scenes_rigidly_changes_nothing_but_the_scenes():
    _, observations = two_scenes(noise_px=1.0)
    moved_by = pose(np.random.default_rng(9))
    moved = [
        Observation(
            o.click, o.ray_camera, moved_by @ o.scene_from_camera, o.depths_m, o.depth_sigmas_m, o.pixel_rad
        )
        for o in observations
    ]
    a, b = solve("cube", NAMES, observations), solve("cube", NAMES, moved)
    between = [
        np.linalg.norm(p[:, None] - p[None], axis=2) for p in (a.model.points_object, b.model.points_object)
    ]
    assert np.allclose(*between, atol=1e-5)


def test_covariance_tells_the_error():
    """Over many noisy solves the squared error, in units of its covariance, averages to about one."""
    random = np.random.default_rng(3)
    ratios = []
    for _ in range(15):
        observations = [
            o
            for name in ("00", "01", "02")
            for o in click_scene(
                name,
                CUBE,
                pose(random),
                cameras(3),
                random,
                noise_px=2.5,
                depths=lambda k, f, z: [z + random.normal(0, 0.0025)],
            )
        ]
        solution = solve("cube", NAMES, observations)
        fit = fit_rigid(solution.model.points_object, CUBE)
        errors = transform(fit, CUBE) - solution.model.points_object
        ratios.append(
            np.mean([e @ np.linalg.pinv(c) @ e / 3 for e, c in zip(errors, solution.covariance, strict=True)])
        )
    assert 0.5 < np.mean(ratios) < 2.0


def test_background_depth_loses_against_the_rigid_model():
    """A third of the clicks see the table behind as well, a tenth see nothing else."""
    random = np.random.default_rng(4)

    def depths(k, frame, z):
        chance = random.random()
        return [z + 0.15] if chance < 0.1 else [z, z + 0.15] if chance < 0.4 else [z]

    truth = [pose(random) for _ in range(4)]
    observations = [
        o
        for s, at in enumerate(truth)
        for o in click_scene(f"{s:02d}", CUBE, at, cameras(2, 0.05), random, noise_px=1.0, depths=depths)
    ]
    solution = solve("cube", NAMES, observations)
    assert error_mm(solution.model.points_object).max() < 5
    assert {r.depth_state for r in solution.residuals} >= {"agrees", "rejected"}


def test_a_swapped_pair_is_named():
    random = np.random.default_rng(6)
    observations = [
        o
        for s in range(4)
        for o in click_scene(f"{s:02d}", CUBE, pose(random), cameras(1), random, noise_px=1.0)
    ]
    a, b = (
        next(i for i, o in enumerate(observations) if o.click.keypoint == k and o.click.scene == "02")
        for k in (1, 6)
    )

    def renamed(o, keypoint):
        c = o.click
        click = Click(c.object, keypoint, c.scene, c.frame, c.u_px, c.v_px)
        return Observation(
            click, o.ray_camera, o.scene_from_camera, o.depths_m, o.depth_sigmas_m, o.pixel_rad
        )

    observations[a], observations[b] = renamed(observations[a], 6), renamed(observations[b], 1)
    solution = solve("cube", NAMES, observations)
    assert error_mm(solution.model.points_object).max() < 6
    blamed = [r for r in solution.residuals if r.outlier]
    assert {(r.click.scene, r.click.keypoint) for r in blamed} == {("02", 1), ("02", 6)}
    assert [s.kind for s in solution.statements if s.kind != "unjudged"] == ["swapped"]
    assert all("keypoints 1 b and 6 g are swapped" in r.reason for r in blamed)


def test_keypoints_clicked_once_or_never_are_said():
    random = np.random.default_rng(7)
    observations = click_scene("00", CUBE, pose(random), cameras(2), random, keypoints=[0, 1, 2, 3, 4, 5, 6])
    observations += click_scene("01", CUBE, pose(random), cameras(2), random, keypoints=[0, 1, 2, 3, 4, 5])
    solution = solve("cube", NAMES, observations)
    assert list(solution.model.known) == [True] * 7 + [False]
    assert "keypoint 7 h was never clicked" in solution.warnings[0]
    assert {s.kind for s in solution.statements} <= {
        "unjudged"
    }  # the two frames of scene 00 check keypoint g
    once = [o for o in observations if o.click.keypoint != 6 or o.click.frame == 0]
    (said,) = (s for s in solve("cube", NAMES, once).statements if s.kind != "unjudged")
    assert (said.kind, said.clicks[0].keypoint) == ("unchecked", 6)
    assert "keypoint 6 g was clicked in one frame only (scene 00, frame 0): nothing checks it" in said.text


def test_a_keypoint_whose_depth_nothing_tells_is_said():
    """Clicked once, where there is no depth: a ray and no place on it."""
    random = np.random.default_rng(3)
    observations = []
    for name in ("s0", "s1"):
        at = pose(random)
        observations += click_scene(name, CUBE, at, cameras(2), random, keypoints=range(7))
        if name == "s0":
            observations += click_scene(
                name, CUBE, at, cameras(1), random, keypoints=[7], depths=lambda k, frame, z: []
            )
    solution = solve("cube", NAMES, observations)
    assert solution.model.known.tolist() == [True] * 7 + [False]
    assert solution.warnings == (
        "keypoint 7 h was clicked, but neither depth nor other frames tell how far away it is: it has no "
        "position and no label; click it where there is depth, or from another side",
    )
    assert error_mm(solution.model.points_object).max() < 0.01


def test_two_shared_points_are_refused_and_named():
    random = np.random.default_rng(8)
    observations = click_scene("00", CUBE, pose(random), cameras(1), random, keypoints=[0, 1, 2, 3, 4])
    observations += click_scene("01", CUBE, pose(random), cameras(1), random, keypoints=[0, 1, 2, 3, 4])
    observations += click_scene("03", CUBE, pose(random), cameras(1), random, keypoints=[4, 1, 5, 6])
    with pytest.raises(
        DataError, match="scene 03 shares only keypoints 1 b, 4 e with the rest; click at least 3 common"
    ):
        solve("cube", NAMES, observations)


def test_two_keypoints_in_one_scene_are_said_to_be_too_few():
    random = np.random.default_rng(8)
    observations = click_scene("00", CUBE, pose(random), cameras(2), random, keypoints=[0, 1])
    with pytest.raises(DataError, match="scene 00: 2 keypoints clicked, and in no other scene any; a scene"):
        solve("cube", NAMES, observations)


def test_three_shared_points_on_a_line_are_refused():
    random = np.random.default_rng(9)
    points = CUBE.copy()
    points[[0, 1, 2]] = [[-0.05, 0.0, 0], [0, 0, 0], [0.05, 0, 0]]
    observations = click_scene("00", points, pose(random), cameras(1), random, keypoints=[0, 1, 2, 3, 4])
    observations += click_scene("01", points, pose(random), cameras(1), random, keypoints=[0, 1, 2, 5, 6])
    with pytest.raises(DataError, match="on a line"):
        solve("cube", NAMES, observations)


def test_scenes_tied_only_as_a_whole_are_solved():
    """No pair shares three keypoints, yet three scenes hinged in a ring are rigid."""
    random = np.random.default_rng(10)
    observations = click_scene("00", CUBE, pose(random), cameras(1), random, keypoints=[0, 1, 2, 3, 6])
    observations += click_scene("01", CUBE, pose(random), cameras(1), random, keypoints=[2, 3, 4, 5])
    observations += click_scene("02", CUBE, pose(random), cameras(1), random, keypoints=[4, 5, 0, 1])
    assert error_mm(solve("cube", NAMES, observations).model.points_object).max() < 0.1


def test_non_finite_numbers_are_refused():
    _, observations = two_scenes()
    o = observations[3]
    broken = Observation(
        o.click, np.array([np.nan, 0, 1]), o.scene_from_camera, o.depths_m, o.depth_sigmas_m, o.pixel_rad
    )
    with pytest.raises(DataError, match="not a finite number"):
        solve("cube", NAMES, [*observations, broken])


def fragments(scenes, keypoints, seed, wrong=0.0):
    """The generator of wrong clicks: 2 mm noise per axis, 60 % seen, gross errors of 5-30 cm."""
    random = np.random.default_rng(seed)
    points = random.uniform(-0.1, 0.1, (keypoints, 3))
    clicked = random.random((scenes, keypoints)) < 0.6
    clicked[:, :4] = True  # tied
    w = np.stack([transform(pose(random), points) for _ in range(scenes)]) + random.normal(
        0, 0.002, (scenes, keypoints, 3)
    )
    bad = (random.random((scenes, keypoints)) < wrong) & clicked
    direction = random.normal(size=w.shape)
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    w[bad] += (direction * random.uniform(0.05, 0.3, (scenes, keypoints, 1)))[bad]
    return points, Fragments(np.where(clicked[..., None], w, 0), clicked.astype(float))


def test_points_l2_reaches_the_cost_of_the_papers_solver():
    _, w = fragments(3, 6, 0)
    ours, papers = solve_points(w, loss="l2"), solve_points(w, method="slsqp")
    assert eq2_cost(w, ours) <= eq2_cost(w, papers) * (1 + 1e-9)
    assert eq2_cost(w, papers) < eq2_cost(w, ours) * 1.05
    assert np.allclose(ours.scene_from_model[0], np.eye(4), atol=1e-12)


@pytest.mark.parametrize("size", [(2, 3), (10, 12)])
def test_points_in_compiled_code_as_by_svd(size):
    for seed in range(3):
        _, w = fragments(*size, seed) if size[1] > 3 else (None, tied_by_three(seed))
        weights = w.clicked * np.random.default_rng(seed).uniform(0.01, 1, w.clicked.shape)
        start = np.stack(join_clean(w))
        poses, points = start.copy(), np.zeros((size[1], 3))
        assert alternate(*w, weights, poses, points, MOST_ALTERNATIONS)
        by_svd = alternate_by_svd(w, weights, start)
        assert np.allclose(points, by_svd.points_model, rtol=0, atol=1e-10)
        assert np.allclose(poses, by_svd.scene_from_model, rtol=0, atol=1e-9)


def tied_by_three(seed):
    random = np.random.default_rng(seed)
    return Fragments(
        np.stack([transform(pose(random), CUBE[:3]) for _ in range(2)]) + random.normal(0, 0.002, (2, 3, 3)),
        np.ones((2, 3)),
    )


@pytest.mark.parametrize("off_line_m", [0.0, 1e-8])
def test_points_on_a_line_are_left_to_the_svd(off_line_m):
    line = np.outer([0.0, 0.05, 0.1], [1.0, 0.5, 0.2]) + [[0, 0, 0], [0, off_line_m, 0], [0, 0, 0]]
    w = Fragments(np.stack([line, line + 0.1]), np.ones((2, 3)))
    start = np.stack([np.eye(4)] * 2)
    assert not alternate(*w, w.clicked, start.copy(), np.zeros((3, 3)), MOST_ALTERNATIONS)
    adjusted = adjust_points(w, start)
    assert eq2_cost(w, adjusted) < 1e-15


def test_points_that_are_no_numbers_are_refused_not_solved():
    w, start = tied_by_three(0), np.stack([np.eye(4)] * 2)
    w.points_scene[1, 2, 0] = np.nan
    assert not alternate(*w, w.clicked, start.copy(), np.zeros((3, 3)), MOST_ALTERNATIONS)
    with pytest.raises(np.linalg.LinAlgError):
        adjust_points(w, start)


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e-9])
def test_a_compiled_pose_is_that_of_kabsch_however_small_the_model(size):
    random = np.random.default_rng(3)
    model, scene, weights = CUBE * size, transform(pose(random), CUBE), random.uniform(0.1, 1, len(CUBE))
    found = np.zeros((4, 4))
    assert _fit(model, scene, weights, found)
    np.testing.assert_allclose(found, kabsch_stack(model, scene[None], weights[None])[0], atol=1e-12)


def test_points_robust_to_gross_errors():
    good = 0
    for seed in range(20):
        points, w = fragments(10, 12, seed, wrong=0.05)
        found = solve_points(w).points_model
        errors = transform(fit_rigid(points, found), found) - points
        good += np.sqrt((errors**2).sum(axis=1).mean()) < 0.005
    assert good >= 18


@pytest.mark.parametrize("keypoints", [[0, 1, 2], [0, 3, 5, 6]])
def test_register_a_new_scene(keypoints):
    random = np.random.default_rng(11)
    model = KeypointModel("cube", NAMES, CUBE)
    at = pose(random)
    observations = click_scene("new", CUBE, at, cameras(1), random, keypoints=keypoints)
    found, residuals = register(model, observations)
    assert np.allclose(found, at, atol=1e-4)
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1)
    assert len(residuals) == len(keypoints)


def test_register_is_never_a_mirror_image():
    random = np.random.default_rng(12)
    model = KeypointModel("cube", NAMES, CUBE)
    for _ in range(50):
        observations = click_scene(
            "new",
            CUBE,
            pose(random),
            cameras(1),
            random,
            noise_px=2,
            keypoints=[0, 3, 5],
            depths=lambda k, f, z: [z + random.normal(0, 0.003)],
        )
        found, _ = register(model, observations)
        assert np.linalg.det(found[:3, :3]) == pytest.approx(1)


def test_register_refuses_too_few_and_collinear():
    random = np.random.default_rng(13)
    points = CUBE.copy()
    points[[0, 1, 2]] = [[-0.05, 0.0, 0], [0, 0, 0], [0.05, 0, 0]]
    model = KeypointModel("cube", NAMES, points)
    with pytest.raises(DataError, match="at least 3"):
        register(model, click_scene("new", points, pose(random), cameras(1), random, keypoints=[0, 5]))
    with pytest.raises(DataError, match="line"):
        register(model, click_scene("new", points, pose(random), cameras(1), random, keypoints=[0, 1, 2]))


def test_register_does_not_use_clicks_on_keypoints_the_model_lacks():
    random = np.random.default_rng(4)
    points = np.where(np.arange(8)[:, None] < 6, CUBE, np.nan)
    model, at = KeypointModel("cube", NAMES, points), pose(random)
    observations = click_scene("new", CUBE, at, cameras(3), random)
    found, residuals = register(model, observations)
    np.testing.assert_allclose(found, at, atol=1e-6)
    assert len(residuals) == len(observations)
    unused = [r for r in residuals if r.click.keypoint >= 6]
    assert {r.reason for r in unused} == {
        "the model has no position of keypoint 6 g", "the model has no position of keypoint 7 h"
    }  # fmt: skip
    assert not any(r.outlier for r in residuals)


def test_many_starts_at_once_end_where_the_best_of_each_alone_does():
    _, w = fragments(4, 6, 3, wrong=0.05)
    turns = Rotation.random(20, rng=np.random.default_rng(0)).as_matrix().reshape(5, 4, 3, 3)
    starts = np.tile(np.eye(4), (5, 4, 1, 1))
    starts[..., :3, :3] = turns
    alone = [adjust_points(w, start, loss="l2") for start in starts]
    best = min(alone, key=lambda adjusted: eq2_cost(w, adjusted))
    np.testing.assert_allclose(best_of_starts(w, starts), best.scene_from_model, atol=1e-9)
