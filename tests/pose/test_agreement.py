"""Poses of single frames: what they agree on, and what does not belong."""

from __future__ import annotations

import numpy as np
import pytest

from rpl_data.geometry import from_rotvec, invert, rotation_angle_rad
from rpl_data.pose.agreement import agreements, keypoint_distance_m, nearest_pose
from rpl_data.symmetries import symmetry_transforms
from rpl_data.types import Symmetries, SymmetryAxis

POINTS = np.array([[0.1, 0, 0], [-0.1, 0, 0], [0, 0.05, 0], [0, 0, 0.05]])
TRUE = from_rotvec(np.array([0.2, -0.4, 1.0]), np.array([0.3, 0.1, 0.5]))


def poses(count: int, *, about: np.ndarray = TRUE, noise: float = 0.005) -> np.ndarray:
    rng = np.random.default_rng(count)
    return np.array(
        [
            about @ from_rotvec(noise * 10 * rng.normal(size=3), noise * rng.normal(size=3))
            for _ in range(count)
        ]
    )


def test_the_largest_group_comes_first_and_strays_are_left_out() -> None:
    turned = TRUE @ from_rotvec(np.array([0, 0, np.pi]), np.zeros(3))
    strays = poses(4, noise=0.3)
    first, second = agreements(np.concatenate([strays, poses(5, about=turned), poses(9)]), POINTS)[:2]
    assert set(first.members) == set(range(9, 18)) and set(second.members) == set(range(4, 9))
    off = invert(TRUE) @ first.scene_from_object
    assert np.linalg.norm(off[:3, 3]) < 0.005 and rotation_angle_rad(off[:3, :3]) < 0.05
    assert first.off_m.max() < 0.03


def test_turns_that_look_the_same_agree() -> None:
    bottle = Symmetries((), (SymmetryAxis((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),))
    same = symmetry_transforms(bottle, max_deviation=0.03)
    angles = np.linspace(0, 2 * np.pi, 8, endpoint=False) + 0.01
    seen = poses(8) @ [from_rotvec(np.array([0, 0, angle]), np.zeros(3)) for angle in angles]
    assert not agreements(seen, POINTS)  # each view turned it otherwise
    [found] = agreements(seen, POINTS, same)
    assert len(found.members) == 8 and found.off_m.max() < 0.03
    nearest = nearest_pose(found.scene_from_object, POINTS, same, to=TRUE, points_to=POINTS)
    assert keypoint_distance_m(nearest, POINTS, TRUE, POINTS) < 0.008


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_frames_agree_on_nothing(count: int) -> None:
    assert agreements(np.tile(TRUE, (count, 1, 1)), POINTS) == []


def test_the_distance_knows_models_in_other_frames() -> None:
    moved = from_rotvec(np.array([0.5, 0, 0]), np.array([0, 0.1, 0]))
    elsewhere = (POINTS @ moved[:3, :3].T) + moved[:3, 3]
    assert keypoint_distance_m(TRUE, POINTS, TRUE @ invert(moved), elsewhere) == pytest.approx(0, abs=1e-12)
    shifted = TRUE.copy()
    shifted[0, 3] += 0.02
    missing = POINTS.copy()
    missing[2] = np.nan
    assert keypoint_distance_m(shifted, POINTS, TRUE, missing) == pytest.approx(0.02)
