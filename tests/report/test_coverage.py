"""The views of an object: shares of the sphere by formula, areas kept by the picture, advice that follows."""

from __future__ import annotations

import numpy as np

from rpl_data.directions import coverage, gaps_deg, spread_directions
from rpl_data.report.coverage import RADIUS, _positions, coverage_section
from rpl_data.report.next_steps import next_steps
from rpl_data.types import Click, ClickResidual, KeypointModel, Solution


def test_one_view_covers_a_cap() -> None:
    """The cap of 15 degrees is (1 - cos 15°) / 2 = 1.7 % of the sphere; two opposite ones are twice that."""
    up = np.array([[0.0, 0.0, 1.0]])
    assert abs(coverage(up) - (1 - np.cos(np.deg2rad(15))) / 2) < 0.002
    assert abs(coverage(np.concatenate([up, -up])) - 2 * coverage(up)) < 0.002
    assert coverage(spread_directions(500)) == 1 and coverage(np.zeros((0, 3))) == 0


def test_equal_shares_of_the_sphere_get_equal_areas() -> None:
    """As many evenly spread directions fall into the inner half of a disc's area as into the outer half."""
    at = _positions(spread_directions(4000))
    left = at[at[:, 0] < 0] + [RADIUS + 10, 0]
    radius = np.linalg.norm(left, axis=1) / RADIUS
    assert radius.max() <= 1 + 1e-9 and len(left) == 2000
    assert abs((radius < np.sqrt(0.5)).mean() - 0.5) < 0.01


def test_the_section_names_objects_safely_and_draws_each_view() -> None:
    views = {"<b>cup</b>": {"00": spread_directions(7), "01": spread_directions(5)}}
    shown = coverage_section(views)
    assert shown.count("<circle") == 12 + 2 and "&lt;b&gt;cup" in shown and "<b>cup" not in shown
    assert coverage_section({}) == ""


def test_advice_follows_what_is_missing() -> None:
    said = " ".join(next_steps([], [], {"cup": 0.1, "kettle": 0.9}))
    assert "3 more scenes" in said and "Record cup turned over" in said and "kettle" not in said


def test_keypoints_that_nothing_checks_are_named() -> None:
    places = [(0, "00"), (0, "01"), (1, "00"), (2, "01"), (2, "01")]
    residuals = tuple(
        ClickResidual(Click("cup", k, scene, 0, 1.0, 1.0), 0.1, None, None, "none") for k, scene in places
    )
    model = KeypointModel("cup", ("rim", "foot", "logo", "lid"), np.zeros((4, 3)))
    solution = Solution(model, np.zeros((4, 3, 3)), {}, residuals)
    (line,) = [line for line in next_steps([], [solution], {}) if "only once" in line]
    assert line.startswith("Click 1 foot of cup once more")


def test_one_view_leaves_the_far_side_open() -> None:
    up = np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(np.sort(gaps_deg(up))[[0, -1]], [0, 180], atol=3)
    np.testing.assert_allclose(np.median(gaps_deg(up)), 90, atol=0.5)
