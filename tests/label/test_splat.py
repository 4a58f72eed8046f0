"""Masks of projected points: the silhouette, wider by a dot's radius at most."""

from __future__ import annotations

import cv2
import numpy as np

from rpl_data.geometry import from_rotvec
from rpl_data.label.alone import cast
from rpl_data.label.occlusion import FAR_M
from rpl_data.label.splat import splat
from rpl_data.meshes import sampled
from rpl_data.raycast import PixelTable, RayScene
from rpl_data.types import Intrinsics, Mesh

CAMERA = PixelTable.of(Intrinsics(500.0, 500.0, 159.5, 119.5, 320, 240))
WHOLE = (slice(0, 240), slice(0, 320))
CORNERS = 0.05 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CUBE = Mesh(CORNERS, np.array([t for a, b, c, d in FACES for t in ([a, b, c], [a, c, d])], dtype=np.int64))


def test_the_splat_of_a_cube_is_its_silhouette() -> None:
    pose = from_rotvec(np.array([0.5, 0.7, 0.1]), np.array([0.02, -0.01, 0.6]))
    points = sampled(CUBE, count=30_000)
    depth_m, mask = splat(points)(CAMERA, WHOLE, pose)
    true_m, silhouette = cast(CUBE, RayScene([CUBE]))(CAMERA, WHOLE, pose)
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
    wider, narrower = cv2.dilate(silhouette.view(np.uint8), disk), cv2.erode(silhouette.view(np.uint8), disk)
    assert not (mask & (wider == 0)).any()
    assert mask[narrower > 0].all()
    inner = narrower > 0
    assert np.abs(depth_m - true_m)[inner].max() < 0.012  # the depth of dots up to 3 px away
    assert ((depth_m < FAR_M) == mask).all()


def test_gaps_within_the_outline_are_filled_and_nothing_is_drawn_behind_the_camera() -> None:
    ring = 0.05 * np.array([[np.cos(a), np.sin(a), 0] for a in np.linspace(0, 2 * np.pi, 400)])
    depth_m, mask = splat(ring)(CAMERA, WHOLE, from_rotvec(np.zeros(3), np.array([0, 0, 0.5])))
    assert mask[119, 159] and abs(depth_m[119, 159] - 0.5) < 1e-6
    depth_m, mask = splat(ring)(CAMERA, WHOLE, from_rotvec(np.zeros(3), np.array([0, 0, -0.5])))
    assert not mask.any() and (depth_m == FAR_M).all()


def test_a_window_holds_the_same_pixels_as_the_whole_image() -> None:
    points = sampled(CUBE, count=4000)
    pose = from_rotvec(np.array([0, 0.3, 0]), np.array([0, 0, 0.6]))
    whole, _ = splat(points)(CAMERA, WHOLE, pose)
    window = (slice(40, 200), slice(60, 260))
    part, _ = splat(points)(CAMERA, window, pose)
    np.testing.assert_array_equal(part, whole[window])
