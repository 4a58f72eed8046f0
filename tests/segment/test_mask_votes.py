"""Given masks vote on points of the surface; frames that contradict the others are out-voted."""

from __future__ import annotations

import numpy as np
import pytest

from rpl_data.geometry import from_rotvec, project, transform
from rpl_data.segment.free_space import DepthView
from rpl_data.segment.mask_votes import MaskView, Verdict, mask_verdict, regions_by_masks
from rpl_data.types import Intrinsics, PointCloud

CAMERA = Intrinsics(200.0, 200.0, 79.5, 59.5, 160, 120)
SIDE_M = 0.1
"""Of the square that is the object, on a larger plane 0.5 m ahead of the cameras."""
X, Y = np.meshgrid(np.linspace(-0.15, 0.15, 61), np.linspace(-0.12, 0.12, 49))
PLANE = np.column_stack([X.ravel(), Y.ravel(), np.zeros(X.size)])
CORNERS = 0.4 * SIDE_M * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
outside_m = np.abs(PLANE[:, :2]).max(axis=1) - SIDE_M / 2
"""Distance of each point from the square, negative on it."""


def view(frame: int, *, shift_px: int = 0, wrong: str = "") -> MaskView:
    """The plane from a camera that moves sideways, with the true mask of the square, changed as asked."""
    pose = from_rotvec(np.zeros(3), np.array([0.005 * frame, 0.0, 0.5]))
    u, v = project(CAMERA, transform(pose, PLANE[outside_m <= 0])).T
    mask = np.zeros((CAMERA.height, CAMERA.width), bool)
    mask[
        round(v.min()) - shift_px : round(v.max()) + 1 + shift_px,
        round(u.min()) - shift_px : round(u.max()) + 1 + shift_px,
    ] = True
    if wrong == "empty":
        mask[:] = False
    if wrong == "elsewhere":
        mask = np.roll(mask, 50, axis=1)
    depth_m = np.full((CAMERA.height, CAMERA.width), 0.5, np.float32)
    return MaskView(frame, DepthView("desk", CAMERA, pose, depth_m), mask)


@pytest.mark.parametrize("shift_px", [0, -3, 3])
def test_masks_that_are_some_pixels_off_judge_alike(shift_px: int) -> None:
    found = mask_verdict(PLANE, [view(n, shift_px=shift_px) for n in range(4)], CORNERS)
    assert isinstance(found, Verdict) and found.wrong_frames == ()
    near_m = 9 * 0.5 / CAMERA.fx  # the outline's 5 px, 3 px of the mask, a pixel of rounding
    assert found.inside[outside_m < -near_m].all() and not found.inside[outside_m > 0.001].any()
    assert found.outside[outside_m > near_m].all() and not found.outside[outside_m < -0.001].any()


@pytest.mark.parametrize("wrong", ["empty", "elsewhere"])
def test_a_wrong_frame_is_out_voted_and_named(wrong: str) -> None:
    views = [view(0), view(1), view(2, wrong=wrong), view(3), view(4)]
    found = mask_verdict(PLANE, views, CORNERS)
    sound = mask_verdict(PLANE, [each for each in views if each.frame != 2], CORNERS)
    assert isinstance(found, Verdict) and isinstance(sound, Verdict)
    assert found.wrong_frames == (2,)
    np.testing.assert_array_equal(found.inside, sound.inside)
    np.testing.assert_array_equal(found.outside, sound.outside)


def test_masks_that_contradict_one_another_are_not_used() -> None:
    views = [view(n, wrong="elsewhere" if n % 2 else "") for n in range(4)]
    assert "agree on no part of the surface" in str(mask_verdict(PLANE, views, CORNERS))


def test_masks_of_another_object_are_not_used() -> None:
    views = [view(n, wrong="elsewhere") for n in range(4)]
    assert "most clicked keypoints lie outside" in str(mask_verdict(PLANE, views, CORNERS))


def test_points_that_no_depth_image_sees_are_left_alone() -> None:
    behind = PLANE + [0, 0, 0.05]
    found = mask_verdict(np.concatenate([PLANE, behind]), [view(n) for n in range(4)], CORNERS)
    assert isinstance(found, Verdict)
    assert not found.outside[len(PLANE) :].any() and not found.inside[len(PLANE) :].any()


def test_regions_lose_what_is_denied_and_gain_what_is_claimed() -> None:
    cloud = PointCloud(PLANE, np.tile([0.0, 0, -1], (len(PLANE), 1)))
    left = PointCloud(PLANE[PLANE[:, 0] < 0], cloud.normals[PLANE[:, 0] < 0])
    regions, lines = regions_by_masks({"desk": left}, {"desk": cloud}, [view(n) for n in range(4)], CORNERS)
    far_m = np.abs(regions["desk"].points[:, :2]).max(axis=1).max()
    assert far_m < SIDE_M / 2 + 7 * 0.5 / CAMERA.fx and regions["desk"].points[:, 0].max() > 0.025
    assert not lines
    kept, _ = regions_by_masks({"desk": left}, {"desk": cloud}, [], CORNERS)
    assert kept["desk"] is left
