"""How far a frame's own images would move a label: the outline of the object in depth and in colour.

The label's mesh says where the outline is. Along its normals, depth says where the object's surface ends and
the background begins, and colour where the strongest edge near by is. One Gauss-Newton step of the object's
pose brings the two together (as tracking by edges does: Drummond and Cipolla, PAMI 2002). What it would move
the keypoints by is how far the label disagrees with this one frame. Nothing is moved: a single frame is too
uncertain for that, but it tells good labels from bad ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.geometry import Points
from rpl_data.label.masks import MaskPatch
from rpl_data.label.occlusion import DepthPatch, Tolerances
from rpl_data.raycast import PixelTable
from rpl_data.types import DepthImage, GreyImage, Window

MOST_POINTS = 120
"""Points of the outline that are looked at."""
REACH_PX = 8
"""Edges are sought this far from the outline, inwards and outwards."""
DEPTH_SIGMA_PX, COLOR_SIGMA_PX = 2.0, 2.0
"""Standard deviation of one edge's position; neighbouring edges err together."""
DEPTH_BIAS_PX = 2.0
"""Depth cameras widen or narrow all outlines alike; by this much (standard deviation)."""
FAINTEST_EDGE = 6.0
"""Smallest step of brightness (of 255) per pixel that is an edge."""
NEAREST_PREFERRED_PX = 4.0
"""Of several edges the strongest counts, those farther from the outline less: a Gaussian of this sigma."""
FEWEST_SIDE_PX, MOST_WRONG_PX = 3, 3
"""Along a normal: least number of pixels on the object and behind it, and most on the wrong side."""
FEWEST_EDGES = 15
KERNEL_SCALE_SIGMAS = 3.0
"""Scale of Geman-McClure's robust loss, in standard deviations."""
PRIOR = np.diag([np.deg2rad(1.0) ** -2] * 3 + [0.005**-2] * 3)
"""Information of the label's pose before the edges are seen: 1 degree and 5 mm."""


@dataclass(frozen=True)
class Outline:
    """Points of a label's outline in an image.

    Attributes:
        uv_px: the points, columns and rows of the image.
        normal: unit normals in the image, outwards.
        depth_m: depth of the object there.
    """

    uv_px: Float64[np.ndarray, "n 2"]
    normal: Float64[np.ndarray, "n 2"]
    depth_m: Float64[np.ndarray, " n"]


@dataclass(frozen=True)
class Edges:
    """Edges found along the normals of an outline.

    Attributes:
        found: at which points there is one.
        offset_px: how far outwards it lies; 0 where there is none.
    """

    found: Bool[np.ndarray, " n"]
    offset_px: Float64[np.ndarray, " n"]


def moved_by_edges_px(
    camera: PixelTable,
    outline: Outline,
    keypoints_camera: Points,
    depth_m: DepthImage | None,
    grey: GreyImage | None,
    tolerances: Tolerances,
) -> float | None:
    """How far the frame's own edges would move the keypoints, in pixels; None where too few edges are found.

    Args:
        keypoints_camera: the label's keypoints, camera frame; unknown ones left out.

    Returns:
        The root mean square over the keypoints.
    """
    from rpl_data.label.compiled_edges import add_equations, motion_along

    if len(outline.uv_px) < FEWEST_EDGES:  # hidden, or nearly so
        return None
    found = []
    if depth_m is not None:
        edges = depth_edges(outline, depth_m, tolerances)
        found.append(_Measured(edges, DEPTH_SIGMA_PX, DEPTH_BIAS_PX))
    if grey is not None:
        found.append(_Measured(color_edges(outline, grey), COLOR_SIGMA_PX, 0.0))
    found = [measured for measured in found if np.count_nonzero(measured.edges.found) >= FEWEST_EDGES]
    if not found:
        return None
    centre = keypoints_camera.mean(axis=0)
    along = motion_along(
        outline.uv_px,
        outline.normal,
        outline.depth_m,
        camera.directions,
        centre,
        camera.intrinsics.fx,
        camera.intrinsics.fy,
    )
    information, pull = PRIOR.copy(), np.zeros(6)
    for edges, sigma_px, bias_px in found:
        add_equations(
            along, edges.found, edges.offset_px, sigma_px, bias_px, KERNEL_SCALE_SIGMAS, information, pull
        )
    moved = image_motion(camera, keypoints_camera, centre) @ np.linalg.solve(information, pull)
    return float(np.sqrt((moved**2).sum(axis=1).mean()))


def outline_of(mask: MaskPatch, usable: MaskPatch, depth_m: DepthPatch, window: Window) -> Outline:
    """Points spread evenly over the outline of a mask, where the object itself is seen.

    Args:
        usable: pixels of the window whose outline is the object's own, not that of what hides it.
        depth_m: depth of the object in the window.
    """
    from rpl_data.label.compiled_edges import spread_over

    contours, _ = cv2.findContours(mask.view(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    points = np.concatenate([contour[:, 0] for contour in contours])
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 2)
    across, down = (cv2.Scharr(smooth, cv2.CV_32F, *axis) for axis in ((1, 0), (0, 1)))
    spread = spread_over(points, usable, MOST_POINTS, across, down, depth_m)
    corner = [window[1].start, window[0].start]
    return Outline(spread[:, :2] + corner, spread[:, 2:4], spread[:, 4])


def depth_edges(outline: Outline, depth_m: DepthImage, tolerances: Tolerances) -> Edges:
    """Where along each normal depth passes from the object to what lies behind it."""
    from rpl_data.label.compiled_edges import mark_cuts

    count = len(outline.uv_px)
    found, offset_px = np.zeros(count, np.bool_), np.zeros(count)
    tolerance_m = tolerances.depth_at_m(outline.depth_m)
    limits = (REACH_PX, FEWEST_SIDE_PX, MOST_WRONG_PX)
    mark_cuts(outline.uv_px, outline.normal, outline.depth_m, tolerance_m, depth_m, *limits, found, offset_px)
    return Edges(found, offset_px)


def color_edges(outline: Outline, grey: GreyImage) -> Edges:
    """Where along each normal the strongest edge of brightness near the outline is, to part of a pixel."""
    offsets = np.arange(-REACH_PX, REACH_PX + 1)
    uv = outline.uv_px[:, None] + outline.normal[:, None] * offsets[:, None]
    inside = _all_inside(uv, grey.shape)
    u, v = uv[..., 0].astype(np.float32), uv[..., 1].astype(np.float32)
    brightness = np.asarray(cv2.remap(grey, u, v, cv2.INTER_LINEAR)).astype(np.float64)
    step = np.abs(np.gradient(brightness, axis=1))
    likely = step * np.exp(-(offsets**2) / (2 * NEAREST_PREFERRED_PX**2))
    best = likely[:, 1:-1].argmax(axis=1) + 1
    row = np.arange(len(best))
    before, peak, after = (likely[row, best + n] for n in (-1, 0, 1))
    part = (before - after) / np.minimum(2 * (before - 2 * peak + after), -1e-9)
    found = inside & (step[row, best] > FAINTEST_EDGE) & (peak >= np.maximum(before, after))
    return Edges(found, np.where(found, offsets[best] + part.clip(-0.5, 0.5) - 0.5, 0.0))


def _all_inside(uv_px: Float64[np.ndarray, "n m 2"], shape: tuple[int, ...]) -> Bool[np.ndarray, " n"]:
    """Whether all pixels along each normal are in the image."""
    uv = np.rint(uv_px)
    limit = np.array([shape[1], shape[0]]) - 1
    return np.asarray(((uv >= 0) & (uv <= limit)).all(axis=(1, 2)))


def image_motion(
    camera: PixelTable, points_camera: Points, centre: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "n 2 6"]:
    """Derivative of projections by a turn about the centre and a shift."""
    from rpl_data.label.compiled_edges import fill_motion

    motion: Float64[np.ndarray, "n 2 6"] = np.empty((len(points_camera), 2, 6))
    fill_motion(points_camera, centre, camera.intrinsics.fx, camera.intrinsics.fy, motion)
    return motion


class _Measured(NamedTuple):
    """Edges of one kind.

    Attributes:
        sigma_px: standard deviation of each offset.
        bias_px: that of what all offsets have in common; 0 where they have nothing in common.
    """

    edges: Edges
    sigma_px: float
    bias_px: float
