"""Keypoints that all clicks see from one side are named."""

import numpy as np

from rpl_data.solve.one_side import describe_one_side, seen_from_one_side


def views_at(*degrees: float) -> np.ndarray:
    angles = np.deg2rad(degrees)
    return np.column_stack([np.sin(angles), np.zeros(len(angles)), np.cos(angles)])


def test_keypoints_are_named_whose_views_all_lie_within_15_degrees() -> None:
    keypoint = np.array([0, 0, 1, 1, 1, 2, 3, 3])
    directions = views_at(0, 14, 0, 7, 16, 0, 90, 91)
    assert seen_from_one_side(keypoint, directions, np.ones(4, bool)) == [0, 3], "2 has one click only"
    assert seen_from_one_side(keypoint, directions, np.array([True, True, True, False])) == [0]


def test_a_line_names_them_or_counts_them() -> None:
    names = ["a", "b", "c", "d", "e", "f"]
    assert describe_one_side(names, []) == ()
    assert describe_one_side(names, [1])[0].startswith(
        "keypoint b marked from one side only (views within 15 "
    )
    assert describe_one_side(names, [1, 2])[0].startswith("keypoints b, c marked")
    assert describe_one_side(names, [0, 1, 2, 3, 4])[0].startswith("5 of 6 keypoints marked")
