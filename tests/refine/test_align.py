"""A known object aligned to a new scene: by print where geometry slides, and only on evidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_surfaces import PointClicks, egg_seen_from, moved

from rpl_data.geometry import from_rotvec, invert, rotation_angle_rad, transform
from rpl_data.meshes import joined, thinned
from rpl_data.refine.align import Alignment, _further_starts, align_scene
from rpl_data.types import PointCloud

TRUE = from_rotvec(np.array([0.4, -1.0, 0.3]), np.array([0.2, -0.1, 0.5]))
POINTS = np.array([[0.05, 0, 0], [0, 0.05, 0], [0, 0, 0.07]])
SIDES = [[1.0, 0, 0], [-1.0, 0, 0]]
MODEL = thinned(
    joined([egg_seen_from(np.array(side), seed=n) for n, side in enumerate(SIDES)]), voxel_m=0.004
)
SEEN = thinned(moved(egg_seen_from(np.array([1.0, 1.0, 0]), seed=5, exposure=0.8), TRUE), voxel_m=0.004)


def aligned(
    start: np.ndarray, seen: PointCloud | None, *others: np.ndarray, loose_m: float = 0.006
) -> Alignment:
    """Aligned from a start that the clicks fit exactly, to `loose_m`, and other starts."""
    clicks = PointClicks(transform(start, POINTS)[None], loose_m)

    def terms(poses: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        normal, gradient = clicks.terms(poses, POINTS)
        return normal[:6, :6], gradient[:6]

    def costs(poses: np.ndarray, points: np.ndarray) -> np.ndarray:
        return clicks.costs(poses, POINTS)

    return align_scene(MODEL, seen, [start, *others], terms, costs)


def off(pose: np.ndarray) -> tuple[float, float]:
    """Millimetres and degrees."""
    wrong = invert(TRUE) @ pose
    return 1e3 * float(np.linalg.norm(wrong[:3, 3])), np.degrees(rotation_angle_rad(wrong[:3, :3]))


def test_the_print_brings_a_round_thing_home() -> None:
    start = TRUE @ from_rotvec(np.array([0.02, 0.02, 0.12]), np.array([0.003, -0.002, 0.002]))
    assert off(start)[1] > 7
    found = aligned(start, SEEN)
    assert found.verdict.accepted, found.verdict.reason
    assert off(found.scene_from_object)[0] < 0.7
    assert off(found.scene_from_object)[1] < 0.5


def test_further_starts_turn_about_the_object_however_far() -> None:
    """Clicks near an axis far from the scene's origin leave the turn about that axis open."""
    clicks = PointClicks(transform(TRUE, 0.2 * POINTS)[None], 0.01)
    normal = clicks.terms(TRUE[None], 0.2 * POINTS)[0][:6, :6]
    starts = _further_starts(TRUE, normal, MODEL)
    centre = MODEL.points.mean(axis=0)
    turned = [rotation_angle_rad((invert(TRUE) @ start)[:3, :3]) for start in starts]
    away_m = [np.linalg.norm(transform(start, centre) - transform(TRUE, centre)) for start in starts]
    assert max(turned) > 1.0 and max(away_m) < 0.12


def test_the_print_chooses_among_several_answers_of_the_clicks() -> None:
    start, other = [TRUE @ from_rotvec(np.array([0, 0, turn]), np.zeros(3)) for turn in (1.2, -0.1)]
    found = aligned(start, SEEN, other, loose_m=0.02)
    assert found.verdict.accepted, found.verdict.reason
    assert off(found.scene_from_object)[1] < 0.5


@pytest.mark.parametrize("seen", ["nothing", "another print"])
def test_the_clicks_are_kept_without_evidence(seen: str) -> None:
    start = TRUE @ from_rotvec(np.array([0, 0, 0.12]), np.zeros(3))
    colours = np.random.default_rng(0).integers(0, 255, SEEN.points.shape).astype(np.uint8)
    found = aligned(start, None if seen == "nothing" else replace(SEEN, colors=colours))
    assert not found.verdict.accepted and found.verdict.reason
    np.testing.assert_array_equal(found.scene_from_object, start)
