"""Depth of another size or place than colour: planes stay planes, edges edges, hidden ground has no depth."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from rpl_data.geometry import from_rotvec, invert, rays, resized, transform
from rpl_data.registered import registered
from rpl_data.types import Intrinsics

COLOR = Intrinsics(700.0, 705.0, 473.0, 351.0, 960, 720)
SMALL = resized(COLOR, width=128, height=96)
NORMAL = np.array([0.5, -0.6, 1.0])
# OpenCV 4 rounds the place between pixels that cv2.remap reads to 1/32 px; OpenCV 5 does not.
ROUNDED = int(cv2.__version__.split(".")[0]) < 5


def plane_m(camera: Intrinsics, normal: np.ndarray = NORMAL, distance_m: float = 0.8) -> np.ndarray:
    """Depth of the plane normal . p = distance at every pixel."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    directions = rays(camera, np.column_stack([u.ravel(), v.ravel()]).astype(float))
    return (distance_m / (directions @ normal)).reshape(camera.height, camera.width).astype(np.float32)


def moved_plane(color_from_depth: np.ndarray) -> tuple[np.ndarray, float]:
    """The plane of the depth camera's frame in that of the colour camera."""
    normal = color_from_depth[:3, :3] @ NORMAL
    return normal, 0.8 + float(normal @ color_from_depth[:3, 3])


def test_a_slanted_plane_stays_one_at_seven_times_the_size() -> None:
    found = registered(plane_m(SMALL), SMALL, COLOR)
    inner = np.s_[
        4:-4, 4:-4
    ]  # beyond the centres of the outermost depth pixels nothing is known of the slope
    np.testing.assert_allclose(found[inner], plane_m(COLOR)[inner], rtol=5e-4 if ROUNDED else 1e-5)
    np.testing.assert_allclose(found, plane_m(COLOR), rtol=0.02)


def test_the_image_of_the_same_camera_is_left_as_it_is() -> None:
    depth = plane_m(SMALL)
    depth[10:20, 30:50] = 0
    found = registered(depth, SMALL, SMALL)
    np.testing.assert_allclose(found[30:-1, :-1], depth[30:-1, :-1], rtol=1e-6)
    assert not found[10:20, 30:50].any()


def test_between_two_surfaces_the_nearer_pixel_counts_and_a_hole_stays_one() -> None:
    """Never a mean of two surfaces; the edge runs between depth pixels 63 and 64, at colour pixel 479.5."""
    depth = np.full((96, 128), 0.7, np.float32)
    depth[:, 64:] = 0.9
    depth[40, 20] = 0
    found = registered(depth, SMALL, COLOR)
    np.testing.assert_allclose(found[200, :480], 0.7, rtol=1e-5)
    np.testing.assert_allclose(found[200, 480:], 0.9, rtol=1e-5)
    hole = np.argwhere(found == 0)
    assert hole.min(axis=0).tolist() == [300, 150] and hole.max(axis=0).tolist() == [307, 157]


@pytest.mark.parametrize("distorted", [False, True])
def test_a_depth_camera_beside_the_colour_camera(distorted: bool) -> None:
    color_from_depth = from_rotvec(np.array([0.1, 0.02, -0.01]), np.array([-0.032, -0.002, 0.004]))
    depth_camera = Intrinsics(250.0, 250.0, 160.0, 142.0, 320, 288)
    if distorted:
        depth_camera = replace(depth_camera, distortion=(0.05, -0.02, 1e-3, -1e-3, 0.01))
    found = registered(plane_m(depth_camera), depth_camera, COLOR, color_from_depth)
    normal, distance_m = moved_plane(color_from_depth)
    true = plane_m(COLOR, normal, distance_m)
    seen = found > 0
    assert seen[200:500, 200:700].all() and seen.mean() > 0.75  # the rest lies outside the depth image
    # Undistorting takes the nearest depth pixel: on this slope half a pixel is 1.2 mm.
    off_m = np.abs(found - true)[seen]
    assert np.percentile(off_m, 99) < (3e-4 if ROUNDED else 5e-5)
    assert off_m.max() < 0.02  # at the depth image's rim, where the slope is not known


def test_what_the_depth_camera_cannot_see_has_no_depth() -> None:
    """A board before a wall: beside its edge the colour camera sees wall that the board hides from depth."""
    camera = Intrinsics(250.0, 250.0, 159.5, 119.5, 320, 240)
    depth = np.full((240, 320), 2.0, np.float32)
    depth[:, :160] = 0.5  # the board's edge is at x = 0 of the depth camera
    color_from_depth = from_rotvec(np.zeros(3), np.array([-0.05, 0.0, 0.0]))
    row = registered(depth, camera, camera, color_from_depth)[120]
    board = round(159.5 - 250 * 0.05 / 0.5)  # where the colour camera sees the edge
    wall = round(159.5 - 250 * 0.05 / 2.0)  # where the wall begins that the depth camera sees
    np.testing.assert_allclose(row[5 : board - 1], 0.5, atol=1e-6)
    assert not row[board + 2 : wall - 2].any()
    np.testing.assert_allclose(row[wall + 2 : -10], 2.0, atol=1e-5)


def test_a_point_is_found_where_it_projects() -> None:
    """The other way round than `registered` works: from a depth pixel to the colour image."""
    color_from_depth = from_rotvec(np.array([0.05, -0.03, 0.2]), np.array([0.04, 0.01, -0.02]))
    depth = plane_m(SMALL)
    found = registered(depth, SMALL, COLOR, color_from_depth)
    point = rays(SMALL, np.array([[60.0, 40.0]]))[0] * depth[40, 60]
    x, y, z = transform(color_from_depth, point)
    u, v = round(COLOR.fx * x / z + COLOR.cx), round(COLOR.fy * y / z + COLOR.cy)
    assert found[v, u] == pytest.approx(z, abs=2e-3)
    assert invert(invert(color_from_depth)) == pytest.approx(color_from_depth)


def test_a_depth_camera_that_bends_its_rims_far_out_loses_none_of_them() -> None:
    """An Azure Kinect: in an image of the same size, a quarter of its pixels would fall outside."""
    lens = (3.13, 2.32, 8e-5, -5e-5, 0.13, 3.46, 3.35, 0.66)
    kinect = Intrinsics(252.0, 252.0, 166.0, 163.0, 320, 288, lens)
    wide = Intrinsics(150.0, 150.0, 159.5, 159.5, 320, 320)
    flat = np.full((288, 320), 0.8, np.float32)
    found = registered(flat, kinect, wide, from_rotvec(np.zeros(3), np.array([-0.03, 0.0, 0.0])))
    v, u = np.mgrid[4:284:20, 4:316:20]
    directions = rays(kinect, np.column_stack([u.ravel(), v.ravel()]).astype(float))
    x, y = 150 * (directions[:, :2] + [-0.03 / 0.8, 0]).T + 159.5
    np.testing.assert_allclose(found[np.rint(y).astype(int), np.rint(x).astype(int)], 0.8, atol=1e-5)


@pytest.mark.parametrize("near_m", [0.21, 0.5, 3.0])
def test_a_colour_image_amid_a_wide_depth_image_has_depth_up_to_its_rims(near_m: float) -> None:
    """Only what the colour camera may see is straightened: that must be all of it, tilted and near."""
    lens = (3.13, 2.32, 8e-5, -5e-5, 0.13, 3.46, 3.35, 0.66)
    kinect = Intrinsics(252.0, 252.0, 166.0, 163.0, 320, 288, lens)
    color = Intrinsics(400.0, 400.0, 159.5, 119.5, 320, 240)
    color_from_depth = from_rotvec(np.array([0.1, 0.0, 0.0]), np.array([-0.032, -0.002, 0.004]))
    flat = np.full((288, 320), near_m, np.float32)
    assert registered(flat, kinect, color, color_from_depth).all()
