"""The space that no depth image saw through, on images of one depth."""

from __future__ import annotations

import numpy as np

from rpl_data.geometry import rigid
from rpl_data.segment.carving import _at_keypoints, carved
from rpl_data.segment.free_space import DepthView
from rpl_data.types import Intrinsics

CAMERA = Intrinsics(100.0, 100.0, 79.5, 59.5, 160, 120)
KEYPOINTS = 0.03 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1]])
AHEAD = rigid(np.eye(3), np.array([0.0, 0.0, 0.5]))


def view(depth_m: float) -> DepthView:
    return DepthView("00", CAMERA, AHEAD, np.full((120, 160), depth_m, np.float32))


def test_space_without_an_end_is_no_object() -> None:
    assert carved(KEYPOINTS, [], [], voxel_m=0.01) is None
    assert carved(KEYPOINTS, [], [view(0.0)], voxel_m=0.01) is None


def test_a_crop_box_ends_it_and_two_images_must_see_through_it() -> None:
    crop = ((-0.05, -0.05, -0.05), (0.05, 0.05, 0.05))
    holes = [view(0.0)] * 3
    for seen_through in ([], [view(2.0)]):
        border = carved(KEYPOINTS, [], [*holes, *seen_through], voxel_m=0.01, crop_m=crop)
        assert border is not None and 0.04 < np.abs(border.points).max() < 0.06
        assert ((border.points * border.normals).sum(axis=1) > 0).all(), "normals point outwards"
    assert carved(KEYPOINTS, [], [*holes, view(2.0), view(2.0)], voxel_m=0.01, crop_m=crop) is None


def test_most_keypoints_lie_on_the_pieces_that_are_kept() -> None:
    filled = np.zeros((20, 4, 4), bool)
    filled[1:3, 1:3, 1:3] = filled[8:10, 1:3, 1:3] = filled[15:17, 1:3, 1:3] = True
    on = [[0.02, 0.02, 0.02], [0.09, 0.02, 0.02]]
    kept = _at_keypoints(filled, np.zeros(3), np.array([*on, [0.12, 0.02, 0.02]]), 0.01)
    assert kept[:12].sum() == 16 and not kept[12:].any()
    none = _at_keypoints(filled, np.zeros(3), np.array([on[0], [0.12, 0.02, 0.02], [0.05, 0.02, 0.02]]), 0.01)
    assert not none.any()
