"""The paper's own solve: it believes the depth of the clicked pixel, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from clicked_scenes import CUBE, NAMES, cameras, click_scene, pose

from rpl_data.geometry import fit_rigid, transform
from rpl_data.solve.slsqp import at_clicked_pixel, measured_fragments
from rpl_data.solve.solve import solve
from rpl_data.types import DataError, Observation


def clicked_once() -> list[Observation]:
    """Two scenes, each with one click on the first five keypoints (SLSQP is slow with more)."""
    random = np.random.default_rng(1)
    return [
        o
        for name in ("00", "01")
        for o in click_scene(name, CUBE, pose(random), cameras(1), random, keypoints=range(5))
    ]


def error_mm(points: np.ndarray) -> float:
    known = np.isfinite(points).all(axis=1)
    fit = fit_rigid(CUBE[known], points[known])
    return float(1e3 * np.linalg.norm(transform(fit, points[known]) - CUBE[known], axis=1).max())


def test_candidates_count_for_nothing() -> None:
    observations = clicked_once()
    lifted = [replace(o, depths_m=o.depths_m + 0.2) for o in observations]
    assert error_mm(solve("cube", NAMES, lifted, method="slsqp").model.points_object) < 0.2


def test_a_background_depth_is_not_repaired_and_nobody_is_blamed() -> None:
    observations = clicked_once()
    observations[3] = replace(observations[3], pixel_depth_m=observations[3].pixel_depth_m + 0.3)
    papers = solve("cube", NAMES, observations, method="slsqp")
    assert error_mm(papers.model.points_object) > 20
    assert error_mm(solve("cube", NAMES, observations).model.points_object) < 0.1
    assert papers.statements == () and not any(residual.outlier for residual in papers.residuals)


def test_a_click_without_depth_is_left_out() -> None:
    observations = clicked_once()
    blind = [replace(o, pixel_depth_m=0.0) if o.click.keypoint == 2 else o for o in observations]
    found = solve("cube", NAMES, blind, method="slsqp")
    assert found.model.known.tolist() == [True, True, False, True, True, False, False, False]
    assert error_mm(found.model.points_object) < 0.2
    assert [r.depth_state for r in found.residuals if r.click.keypoint == 2] == ["none", "none"]
    with pytest.raises(DataError, match="scene 01"):
        solve("cube", NAMES, [replace(o, pixel_depth_m=0.0) if o.click.scene == "01" else o for o in blind],
              method="slsqp")  # fmt: skip


def test_several_clicks_weigh_as_many_terms_of_eq2() -> None:
    (click,) = click_scene("00", CUBE, pose(np.random.default_rng(0)), cameras(1), np.random, keypoints=[1])
    farther = replace(click, pixel_depth_m=click.pixel_depth_m + 0.03)
    w = measured_fragments([click, click, farther], ["00"], 8)
    assert w.clicked.tolist() == [[0, 3, 0, 0, 0, 0, 0, 0]]
    expected = transform(click.scene_from_camera, (click.pixel_depth_m + 0.01) * click.ray_camera)
    np.testing.assert_allclose(w.points_scene[0, 1], expected, atol=1e-12)
    assert at_clicked_pixel(farther).depths_m.tolist() == [farther.pixel_depth_m]
