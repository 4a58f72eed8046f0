"""Keypoints that all clicks see from one side are named."""

import numpy as np
from clicked_scenes import CUBE, click_scene, pose
from scipy.spatial.transform import Rotation

from rpl_data.geometry import invert, rigid
from rpl_data.solve.bundle_adjustment import State
from rpl_data.solve.click_rays import Noise, rays_of
from rpl_data.solve.diagnosis import Placed
from rpl_data.solve.one_side import describe_one_side, one_sided, seen_from_one_side


def views_at(*degrees: float) -> np.ndarray:
    angles = np.deg2rad(degrees)
    return np.column_stack([np.sin(angles), np.zeros(len(angles)), np.cos(angles)])


def test_keypoints_are_named_whose_views_all_lie_within_15_degrees() -> None:
    keypoint = np.array([0, 0, 1, 1, 1, 2, 3, 3])
    directions, measured = views_at(0, 14, 0, 7, 16, 0, 90, 91), np.ones(8, bool)
    every, but_3 = np.ones(4, bool), np.array([True, True, True, False])
    assert seen_from_one_side(keypoint, directions, measured, every) == [0, 3], "2 has one click only"
    assert seen_from_one_side(keypoint, directions, measured, but_3) == [0]
    measured[[0, 6, 7]] = False
    assert seen_from_one_side(keypoint, directions, measured, every) == [0], "rays alone tell where 3 is"


def placed(degrees: tuple[float, ...], beside_px: float) -> Placed:
    """The truth as an answer, seen by cameras at these angles; the last click on keypoint 0 is beside it."""
    at, pivot = pose(np.random.default_rng(1)), rigid(np.eye(3), np.array([0, 0, 0.7]))
    turns = [Rotation.from_euler("y", angle, degrees=True).as_matrix() for angle in degrees]
    views = [pivot @ rigid(turn, np.zeros(3)) @ invert(pivot) for turn in turns]
    observations = click_scene("00", CUBE, at, views, np.random.default_rng(1))
    rays = rays_of(observations, ["00"])
    rays.xy[-len(CUBE)] += beside_px * rays.pixel_rad[0]
    known, sure = np.ones(len(CUBE), bool), {"00": np.zeros((len(CUBE), 3, 3))}
    return Placed(["00"], rays, State(at[None], CUBE), Noise(2.0), np.zeros((30, 30)), sure, known, {}, {})


def test_a_wrong_click_is_no_other_side() -> None:
    assert one_sided(placed((0, 4), 0.0)) == list(range(len(CUBE)))
    assert one_sided(placed((0, 4, 60), 0.0)) == []
    assert one_sided(placed((0, 4, 60), 40.0)) == [0]


def test_a_line_names_them_or_counts_them() -> None:
    names = ["a", "b", "c", "d", "e", "f"]
    assert describe_one_side(names, []) == ()
    assert describe_one_side(names, [1])[0].startswith(
        "keypoint b marked from one side only (views within 15 "
    )
    assert describe_one_side(names, [1, 2])[0].startswith("keypoints b, c marked")
    assert describe_one_side(names, [0, 1, 2, 3, 4])[0].startswith("5 of 6 keypoints marked")
