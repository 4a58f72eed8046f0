"""Normal equations by scenes: the same as with the whole jacobian, whose rows know one scene and keypoint."""

import numpy as np
import pytest
from clicked_scenes import CUBE, cameras, click_scene, pose

from rpl_data.solve.bundle_adjustment import State, linearise, normal_equations
from rpl_data.solve.click_rays import Noise, rays_of
from rpl_data.solve.sparse_normal import solved_by_scenes


@pytest.mark.parametrize("strayed_m", [0.0, 0.004])
def test_the_same_as_with_the_whole_jacobian(strayed_m):
    random = np.random.default_rng(3)
    truth = {name: pose(random) for name in ("00", "01", "02")}
    seen = {"00": range(8), "01": range(5), "02": range(3, 8)}
    observations = [
        o
        for name, at in truth.items()
        for o in click_scene(name, CUBE, at, cameras(2), random, noise_px=4.0, keypoints=seen[name])
    ]
    rays = rays_of(observations, list(truth), dict.fromkeys(("00", "02"), strayed_m))
    state = State(np.stack(list(truth.values())), CUBE + random.normal(0, 0.003, CUBE.shape))
    whole, found = (work(rays, state, noise=Noise()) for work in (linearise, normal_equations))
    rows = (whole.root_weight[..., None] * whole.jacobian).reshape(-1, 18 + CUBE.size)
    np.testing.assert_allclose(found.normal, rows.T @ rows, rtol=1e-9, atol=1e-6)
    residual = (whole.root_weight * whole.residual).ravel()
    np.testing.assert_allclose(found.gradient, rows.T @ residual, rtol=1e-9, atol=1e-6)
    assert found.cost == pytest.approx(whole.cost)
    damped = found.normal + np.diag(0.01 * np.diag(found.normal))
    step = solved_by_scenes(damped, -found.gradient, 3)
    np.testing.assert_allclose(damped @ step, -found.gradient, rtol=1e-7, atol=1e-5)
