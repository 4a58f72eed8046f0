"""How far off a label can be: from what its pose was made of, and from what its own frame shows.

``sigma_px`` of a keypoint joins two sources. The covariance of the keypoint's position in the scene says what
clicks and surfaces leave open; it is the same for all frames. Single frames are worse than that where the
camera moves fast, its path strays, or the surfaces do not fit. They show it: by how fast the object passes,
how far the outline in depth and colour lies from the label's, and how much depth disagrees within it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import transform
from rpl_data.label.alone import ObjectAlone
from rpl_data.label.masks import MaskPatch
from rpl_data.label.occlusion import FAR_M, DepthPatch, Tolerances, depth_disagreement
from rpl_data.label.outline import REACH_PX, moved_by_edges_px, outline_of
from rpl_data.pose.projection import projected_variance
from rpl_data.raycast import PixelTable
from rpl_data.types import DepthImage, GreyImage

EDGE_NOISE_PX = 0.7
"""A single frame's edges would move even a perfect label by about this much."""
SEEN_BY_EDGES_PX = REACH_PX / 2
"""Where a path strays farther than this, single frames do not show all of it."""
PER_PRINT = 2.0
"""A label's error in its frame is at most about this many times what the print moves it by, for the reference
that the print comes from is off too."""
TIMING_SIGMA_S = 0.004
"""The rows of a colour image, the depth image and the pose of a frame belong to moments that differ by about
this much (standard deviation)."""
USUAL_DISAGREEMENT = 0.3
"""Share of the pixels whose depth may disagree by what edges and dark surfaces do to depth alone."""
UNCOVERED = 0.886
"""A disc of area A and diameter d, moved by e, uncovers 4 e / (pi d) of itself: e is 0.886 sqrt(A) times that
share."""
ERROR_PER_SIGMA = 1.25
"""Mean length of an error in the image with standard deviation 1 per axis, sqrt(pi / 2)."""
HALF_QUALITY_PX = 5.0
"""Expected error at which the quality of a label is 0.5."""


def sigma_px(
    camera: PixelTable,
    alone: ObjectAlone,
    visible: MaskPatch,
    depth_m: DepthImage | None,
    grey: GreyImage | None,
    tolerances: Tolerances,
    *,
    speed_px_s: float = 0.0,
    by_print_px: float | None = None,
) -> Float64[np.ndarray, " k"]:
    """Standard deviation of each projected keypoint per axis (root mean square of u and v).

    Args:
        speed_px_s: how fast the object passes through the image.
        by_print_px: how far the frame's print of the object moves the label (`frame_correction`), whether it
            was moved or not; None where it says nothing.
        visible: the object's pixels that nothing hides, in its window.
        depth_m, grey: the images of the frame; None where it has none, or they are not looked at.

    Returns:
        NaN for keypoints without a position.
    """
    item = alone.body.item
    points, pose = item.model.points_object, alone.camera_from_object
    variance = projected_variance(camera.intrinsics, pose, points, item.covariance)
    strayed = np.zeros(len(points))
    if item.strayed_m:
        strays = np.broadcast_to(item.strayed_m**2 * np.eye(3), item.covariance.shape)
        strayed = projected_variance(camera.intrinsics, pose, points, strays)
    by_edges_px = _moved_px(camera, alone, visible, depth_m, grey, tolerances)
    shown = [] if by_edges_px is None else [max(by_edges_px**2 - EDGE_NOISE_PX**2, 0.0)]
    if by_print_px is not None:
        shown.append((PER_PRINT * by_print_px) ** 2)
    if shown:
        # What the frame itself shows takes the place of how far the scene's poses stray on average. Either
        # witness alone may be noise: edges by motion blur and mesh, the print by a change of light.
        strayed = strayed * (strayed / (strayed + SEEN_BY_EDGES_PX**2))
        variance += min(shown)
    variance += strayed + (speed_px_s * TIMING_SIGMA_S) ** 2
    variance += _misplaced_px(alone, visible, depth_m, tolerances) ** 2
    sigma: Float64[np.ndarray, " k"] = np.sqrt(variance)
    return sigma


def quality(sigmas_px: Float64[np.ndarray, " k"]) -> float:
    """Quality of a label, from 1 (certain) to 0: 1 / (1 + e / 5 px), where e is its expected error.

    So 0.8 stands for an expected error of 1.25 px, 0.5 for 5 px, 0.25 for 15 px.

    Args:
        sigmas_px: of its keypoints; those without a position count for nothing. 0 when there are no others.
    """
    known = sigmas_px[np.isfinite(sigmas_px)]
    if not len(known):
        return 0.0
    expected_px = ERROR_PER_SIGMA * float(np.sqrt((known**2).mean()))
    return 1 / (1 + expected_px / HALF_QUALITY_PX)


def expected_error_px(label_quality: float) -> float:
    """The expected error that a quality stands for; infinite for 0."""
    return HALF_QUALITY_PX * (1 / label_quality - 1) if label_quality > 0 else float("inf")


def _moved_px(
    camera: PixelTable,
    alone: ObjectAlone,
    visible: MaskPatch,
    depth_m: DepthImage | None,
    grey: GreyImage | None,
    tolerances: Tolerances,
) -> float | None:
    """How far the frame's edges would move the keypoints; None where they say nothing."""
    keypoints = transform(alone.camera_from_object, alone.body.item.model.points_object)
    ahead = keypoints[keypoints[:, 2] > 0]
    if (depth_m is None and grey is None) or not len(ahead):
        return None
    outline = outline_of(alone.mask, visible & (alone.depth_m < FAR_M), alone.depth_m, alone.window)
    return moved_by_edges_px(camera, outline, ahead, depth_m, grey, tolerances)


def _misplaced_px(
    alone: ObjectAlone, visible: MaskPatch, depth_m: DepthImage | None, tolerances: Tolerances
) -> float:
    """How far an object must be off for so many of its pixels to have another depth than expected."""
    if depth_m is None:
        return 0.0
    measured: DepthPatch = depth_m[alone.window]
    disagreeing = depth_disagreement(alone.depth_m, visible, measured, tolerances)
    size_px = float(np.sqrt(alone.mask.sum()))
    return UNCOVERED * size_px * max(disagreeing - USUAL_DISAGREEMENT, 0.0)
