"""Keypoints that all clicks see from one side are named."""

import numpy as np

from rpl_data.solve.one_side import describe_one_side, seen_from_one_side


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


def test_a_line_names_them_or_counts_them() -> None:
    names = ["a", "b", "c", "d", "e", "f"]
    assert describe_one_side(names, []) == ()
    assert describe_one_side(names, [1])[0].startswith(
        "keypoint b marked from one side only (views within 15 "
    )
    assert describe_one_side(names, [1, 2])[0].startswith("keypoints b, c marked")
    assert describe_one_side(names, [0, 1, 2, 3, 4])[0].startswith("5 of 6 keypoints marked")
