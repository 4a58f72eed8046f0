"""What surfaces count for in a registration, and what becomes of the evidence, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from rpl_data.refine.evidence import ANOTHER_PRINT, cross_validated, verdicts
from rpl_data.refine.registration import register_scenes
from rpl_data.refine.same_print import _another, _Compared
from rpl_data.refine.scene_surfaces import SceneSurface, scene_surface
from rpl_data.types import PointCloud


def flat(edge_m: float = 0.084) -> SceneSurface:
    """A square without print, on which every point lies in a cube of its own."""
    across = np.arange(0.002, edge_m, 0.004)
    x, y = (axis.ravel() for axis in np.meshgrid(across, across))
    points = np.column_stack([x, y, np.zeros_like(x)])
    return scene_surface(PointCloud(points, np.tile([0.0, 0.0, 1.0], (len(x), 1))))


def no_clicks(poses: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((6 * len(poses),) * 2), np.zeros(6 * len(poses))


@pytest.mark.parametrize("scenes", [2, 3])
def test_what_a_scene_sees_counts_the_same_however_many_others_see_it(scenes: int) -> None:
    """Its points of 4 mm count 2 x (4 / 20)^2 each, shared among its partners, and theirs likewise."""
    surface, poses = flat(), np.tile(np.eye(4), (scenes, 1, 1))
    found = register_scenes([surface] * scenes, poses, np.empty((0, 3)), no_clicks)
    assert found.surface_sigma_m == 0.0008, "they lie in one another"
    inner = int((~surface.rim[surface.asking]).sum())
    assert 200 < inner < 441
    assert found.normal[5, 5] == pytest.approx(2 * inner * 2 * (4 / 20) ** 2 / 0.0008**2)


def test_each_part_is_held_out_once() -> None:
    surface = flat()
    tests = cross_validated([surface] * 2, np.tile(np.eye(4), (2, 1, 1)), np.empty((0, 3)), no_clicks)
    (one, other) = (set(test.held_out[0].asking.tolist()) for test in tests)  # type: ignore[union-attr]
    assert not one & other and one | other == set(surface.asking.tolist())


def test_either_witness_turns_a_scene_down() -> None:
    """Of chi-squared numbers with 6 degrees of freedom one in 1000 is above 22.46 (tables)."""
    gains, costs = np.array([1.7, 1.6, 1.7, 1.7]), np.array([22.4, 0.0, 22.5, 0.0])
    found = verdicts(gains, costs, another_print=np.array([False, False, False, True]))
    assert [verdict.accepted for verdict in found] == [True, False, False, False]
    assert "do not agree better" in found[1].reason and "fit much worse" in found[2].reason
    assert (found[0].reason, found[3].reason) == ("", ANOTHER_PRINT)


def test_another_print_correlates_less_and_differs_more_than_that_of_the_others() -> None:
    others = [_Compared((0, 1), 0.8, 1.0), _Compared((1, 0), 0.8, 1.0)]

    def another(correlation: float, difference: float) -> bool:
        return _another([*others, _Compared((2, 0), correlation, difference)], 2)

    assert another(0.39, 2.1)
    assert not another(0.41, 2.1), "more than half as well as the others"
    assert not another(0.39, 1.9), "a plain side: it hardly differs"
    assert not _another([_Compared((2, 0), 0.1, 9.0)], 2), "two scenes: nothing to compare with"
