"""Scenes placed by `rpl register` follow their model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rpl_data.geometry import from_rotvec, invert, transform
from rpl_data.pipeline.placements import with_placements
from rpl_data.types import Click, ClickResidual, KeypointModel, Placement, Solution
from rpl_data.workspace.workspace import Workspace

POINTS = np.array([[0.05, 0, 0], [0, 0.05, 0], [0, 0, 0.07], [np.nan] * 3])
POSE = from_rotvec(np.array([0.4, -1.0, 0.3]), np.array([0.2, -0.1, 0.5]))
CLICK = ClickResidual(Click("egg", 1, "07", 3, 10.0, 20.0), 1.0, None, None, "none")
PLACED = Placement(POSE, POINTS, np.tile(1e-6 * np.eye(3), (4, 1, 1)), (CLICK,), "aligned", "its print")
SOLUTION = Solution(
    KeypointModel("egg", ("a", "b", "c", "d"), POINTS), np.zeros((4, 3, 3)), {"00": np.eye(4)}
)


def test_a_placement_follows_the_keypoints_into_another_frame() -> None:
    other = from_rotvec(np.array([0.1, 0.2, 0.3]), np.array([0.01, 0.02, -0.03]))
    model = replace(SOLUTION.model, points_object=transform(other, POINTS))
    found = with_placements(replace(SOLUTION, model=model), {"07": PLACED})
    np.testing.assert_allclose(found.scene_from_object["07"], POSE @ invert(other), atol=1e-12)
    assert set(found.covariance_in_scene) == {"07"} and found.residuals == (CLICK,)


def test_of_another_model_nothing_is_kept() -> None:
    model = replace(SOLUTION.model, points_object=1.3 * POINTS)
    found = with_placements(replace(SOLUTION, model=model), {"07": PLACED})
    assert set(found.scene_from_object) == {"00"}
    assert "scene 07 is not placed any more" in found.warnings[0]


def test_placements_survive_the_disk(tmp_path) -> None:
    workspace = Workspace(tmp_path)
    assert workspace.load_placements("egg") == {}
    workspace.save_placements("egg", {"07": PLACED})
    (again,) = workspace.load_placements("egg").values()
    np.testing.assert_array_equal(again.points_object, POINTS)
    np.testing.assert_allclose(again.scene_from_object, POSE)
    assert (again.residuals, again.how, again.checked) == ((CLICK,), "aligned", "its print")
