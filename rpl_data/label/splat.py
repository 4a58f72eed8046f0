"""Masks from the points of a dense model: dots, closed to an area (the paper's way, III-E).

The paper projects each point of the dense model. How dots become a mask it does not say; sizes are those of
the authors' program (RapidPoseLabels, `src/utils/annotations.py`).
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from scipy.ndimage import binary_fill_holes, distance_transform_edt

from rpl_data.geometry import Points, Transform, transform
from rpl_data.label.masks import MaskPatch, cleaned
from rpl_data.label.occlusion import FAR_M, DepthPatch
from rpl_data.raycast import PixelTable
from rpl_data.types import Window

DOT = cv2.circle(np.zeros((5, 5), np.uint8), (2, 2), 2, 1, -1)
"""A point covers a disk with a radius of 2 px."""
CLOSED_PX = 5
"""Gaps up to this width are closed."""


def splat(
    points: Points,
) -> Callable[[PixelTable, Window, Transform], tuple[DepthPatch, MaskPatch]]:
    """Draw an object by its points (object frame): as dots, closed, and filled within their outline.

    The depth is that of the nearest dot; where a gap was filled, that of the dot beside it.
    """

    def draw(
        camera: PixelTable, window: Window, camera_from_object: Transform
    ) -> tuple[DepthPatch, MaskPatch]:
        depth_m = _dots_m(camera, transform(camera_from_object, points), window)
        dots = depth_m < FAR_M
        if not dots.any():
            return depth_m, dots
        mask = binary_fill_holes(cleaned(dots, "close", size_px=CLOSED_PX))
        beside = distance_transform_edt(~dots, return_distances=False, return_indices=True)
        return np.where(mask, depth_m[tuple(beside)], np.float32(FAR_M)), mask

    return draw


def _dots_m(camera: PixelTable, points_camera: Points, window: Window) -> DepthPatch:
    """Depth of the nearest dot in each pixel of the window; FAR_M where there is none."""
    shape = (window[0].stop - window[0].start, window[1].stop - window[1].start)
    pixels = camera.project(points_camera) - (window[1].start, window[0].start)
    known = np.isfinite(pixels).all(axis=1)
    column, row = np.rint(pixels[known]).astype(int).T
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    depth_m = np.full(shape, FAR_M, np.float32)
    np.minimum.at(depth_m, (row[inside], column[inside]), points_camera[known, 2][inside].astype(np.float32))
    found: DepthPatch = cv2.erode(depth_m, DOT)
    return found
