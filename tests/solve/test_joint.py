"""The clicks as a part of a larger adjustment."""

from dataclasses import replace

import numpy as np
import pytest
from clicked_scenes import CUBE, NAMES, cameras, click_scene, pose

from rpl_data.solve.joint import joint_clicks
from rpl_data.solve.solve import solve
from rpl_data.solve.witnesses import Contradiction


def clicked(random):
    observations = []
    for name in ("00", "01", "02"):
        observations += click_scene(
            name, CUBE, pose(random), cameras(1), random, noise_px=2.0,
            depths=lambda k, f, z: [z + random.normal(0, 0.0025)],
        )  # fmt: skip
    return observations


def test_what_strays_within_a_scene_still_widens_its_covariance_after_a_larger_adjustment():
    observations = clicked(np.random.default_rng(1))
    found = {}
    for strayed_m in (0.0, 0.003):
        clicks = joint_clicks(
            solve("cube", NAMES, observations, trajectory_sigma_m={"01": strayed_m}), observations
        )
        normal, _ = clicks.terms(clicks.scene_from_object, clicks.points_object)
        solution = clicks.solved(clicks.scene_from_object, clicks.points_object, 4 * normal)
        found[strayed_m] = solution.covariance_in_scene
    wider = {name: found[0.003][name] - found[0.0][name] for name in ("00", "01")}
    np.testing.assert_allclose(wider["00"], 0, atol=1e-12)
    np.testing.assert_allclose(wider["01"], np.tile(9e-6 * np.eye(3), (8, 1, 1)), atol=1e-12)


def test_other_answers_widen_a_scene_only_until_more_than_clicks_speaks_for_this_one():
    observations = clicked(np.random.default_rng(2))
    solution = solve("cube", NAMES, observations, trajectory_sigma_m={"01": 0.003})
    wide = {name: found + 1e-4 * np.eye(3) for name, found in solution.covariance_in_scene.items()}
    clicks = joint_clicks(replace(solution, covariance_in_scene=wide), observations)
    answer = clicks.scene_from_object, clicks.points_object
    normal, _ = clicks.terms(*answer)
    open_, settled = (
        clicks.solved(*answer, normal, settled=scenes).covariance_in_scene for scenes in ((), ("01",))
    )
    np.testing.assert_allclose(open_["00"], settled["00"], atol=1e-15)
    np.testing.assert_allclose(open_["01"] - settled["01"], np.tile(1e-4 * np.eye(3), (8, 1, 1)), atol=1e-9)


def test_what_contradicts_the_clicks_widens_all_that_is_stated():
    """With the prior of 3 residuals: (3 + 24) / (3 + 6) = 3 for two scenes, (3 + 24) / (3 + 24) for five."""
    factors = [Contradiction(24.0, scenes).factor for scenes in (1, 2, 5)]
    np.testing.assert_allclose(factors, [1, np.sqrt(3), 1])
    observations = clicked(np.random.default_rng(3))
    clicks = joint_clicks(solve("cube", NAMES, observations), observations)
    poses, points, all_ = clicks.scene_from_object.copy(), clicks.points_object, ("00", "01", "02")
    normal, _ = clicks.terms(poses, points)
    assert clicks.contradiction(poses, points, all_) == Contradiction(0.0, 3)
    poses[1, :3, 3] += 0.01
    found = clicks.contradiction(poses, points, all_)
    rise = clicks.costs(poses, points).sum() - clicks.costs(clicks.scene_from_object, points).sum()
    assert (found.rise, found.scenes) == (pytest.approx(rise), 3) and rise > 50
    assert clicks.contradiction(poses, points, ("00", "01")).scenes == 2, "the others are held by clicks"
    alone, contradicted = (
        clicks.solved(poses, points, normal, settled=all_, widened=widened) for widened in (1.0, 1.5)
    )
    np.testing.assert_allclose(contradicted.covariance, 1.5**2 * alone.covariance)
    for name, in_scene in alone.covariance_in_scene.items():
        np.testing.assert_allclose(contradicted.covariance_in_scene[name], 1.5**2 * in_scene)


def test_what_chance_does_is_no_contradiction():
    """98 % of chi-squared numbers with 6 degrees of freedom are below 15.03, with 18 below 32.35 (tables)."""
    assert not Contradiction(15.0, 2).beyond_chance and Contradiction(15.1, 2).beyond_chance
    assert not Contradiction(32.3, 4).beyond_chance and Contradiction(32.4, 4).beyond_chance
    assert not Contradiction(1e6, 1).beyond_chance, "one scene alone contradicts nothing"
