"""The dense model of what a depth camera does not see, carved out of the space that it never saw through.

Depth images of dark, shiny or clear objects have holes in their place, so there is no surface to grow a
region on. But the surroundings are measured: what a camera saw through is not the object, nor is what lies
below the table. The rest is the object's visual hull (Laurentini, "The visual hull concept for
silhouette-based image understanding", PAMI 1994), with holes of depth images as silhouettes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy import ndimage
from scipy.spatial import cKDTree

from rpl_data.geometry import NEAREST_M, Points, project, transform
from rpl_data.segment.free_space import MARGIN_M, WITNESSES, DepthView, border, witnesses
from rpl_data.segment.region_growing import (
    CropBox,
    Plane,
    beyond_support_halo,
    box_around_keypoints,
    inside,
)
from rpl_data.types import PointCloud

MOST_CELLS = 160
"""Along the longest side of the box that is searched; large objects get larger cells."""
BELOW_M = 0.003
"""A cell this far below the plane of a support is not the object; scenes are placed no better than that."""
NEAR_M = 0.01
"""A keypoint this near to a carved piece lies on it."""
LEAST_KEYPOINTS = 2 / 3
"""Share of the keypoints that must lie on the carved object."""
LEAST_UNMEASURED = 0.5
"""Share of the pixels of a carved object without depth; with less, its surface was measured, and clicks or
poses are wrong, or it does not stand out from its support."""


def carved(
    keypoints: Points,
    planes: Sequence[Plane],
    views: Sequence[DepthView],
    *,
    voxel_m: float,
    crop_m: CropBox | None = None,
) -> PointCloud | None:
    """The border of the space around the keypoints that no depth image saw through.

    Args:
        keypoints: object frame.
        planes: what the object stands on or in front of in each scene, in the object frame.
        views: depth images of the scenes.
        voxel_m: edge of the cells that are each called free or filled.
        crop_m: lowest and highest corner of a box; everything outside is cut.

    Returns:
        Points with normals that point out of the object; None without depth images, and where that space is
        no object: where keypoints do not lie on it, where it has no end near them, or where depth was
        measured on it.
    """
    if not views:
        return None
    low, high = box_around_keypoints(keypoints)
    cell_m = max(voxel_m, float((high - low).max()) / MOST_CELLS)
    size = np.ceil((high - low) / cell_m).astype(np.int64) + 1
    cells = np.indices(size).reshape(3, -1).T * cell_m + low
    filled = np.ones(len(cells), bool)
    if crop_m is not None:
        filled &= inside(cells, crop_m)
    for plane in planes:
        filled &= plane.height_m(cells) > -BELOW_M
    filled[filled] = _not_free(cells[filled], views)
    for plane in planes:
        filled[filled] = beyond_support_halo(cells[filled], plane, keypoints)
    filled = _at_keypoints(filled.reshape(size), low, keypoints, cell_m)
    inner = filled[1:-1, 1:-1, 1:-1]
    if not filled.any() or inner.sum() < filled.sum():
        return None
    if _unmeasured_share(cells[filled.ravel()], views) < LEAST_UNMEASURED:
        return None
    return border(filled, low, cell_m=cell_m)


def _not_free(cells: Points, views: Sequence[DepthView]) -> Bool[np.ndarray, " n"]:
    """Which cells too few views saw through; those that are known to be free are not looked at again."""
    count, left = np.zeros(len(cells), np.int64), np.arange(len(cells))
    for view in views:
        count[left] += witnesses(cells[left], [view], margin_m=MARGIN_M)
        left = left[count[left] < WITNESSES]
    return count < WITNESSES


def _at_keypoints(
    filled: Bool[np.ndarray, "x y z"], low: Float64[np.ndarray, "3"], keypoints: Points, cell_m: float
) -> Bool[np.ndarray, "x y z"]:
    """The connected pieces that the keypoints lie on; empty where too few lie on any."""
    piece: Int64[np.ndarray, "x y z"] = ndimage.label(filled)[0]
    where = np.argwhere(filled)
    if not len(where):
        return filled
    distance_m, nearest = cKDTree(low + cell_m * where).query(keypoints)
    near = distance_m < NEAR_M
    if near.mean() < LEAST_KEYPOINTS:
        return np.zeros_like(filled)
    found: Bool[np.ndarray, "x y z"] = filled & np.isin(piece, piece[tuple(where[nearest[near]].T)])
    return found


def _unmeasured_share(cells: Points, views: Sequence[DepthView]) -> float:
    """Share of the pixels on which the cells lie that have no depth, in all views together."""
    holes = pixels = 0
    for view in views:
        in_camera = transform(view.camera_from_object, cells)
        in_camera = in_camera[in_camera[:, 2] > NEAREST_M]
        u, v = np.unique(np.round(project(view.intrinsics, in_camera)).astype(np.int64), axis=0).T
        within = (u >= 0) & (u < view.intrinsics.width) & (v >= 0) & (v < view.intrinsics.height)
        holes += int((view.depth_m[v[within], u[within]] == 0).sum())
        pixels += int(within.sum())
    return holes / max(pixels, 1)
