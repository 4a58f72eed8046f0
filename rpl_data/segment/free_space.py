"""Free space: a point is empty where depth images measured a surface behind it.

The surfaces of the scenes say where the object is; depth images also say where it is not. That limits how far
the sides that no camera saw can reach.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy import ndimage

from rpl_data.geometry import NEAREST_M, Points, Transform, invert, project, transform
from rpl_data.types import DepthImage, Intrinsics, Mesh, PointCloud

CELL_M = 0.005
"""Edge of the cells that are each called free or possibly filled."""
MARGIN_M = 0.008
"""A depth image sees through a point when it measures a surface at least this far behind it."""
WITNESSES = 2
"""Depth images that must see through a point to make it free: a single one may be wrong."""


@dataclass(frozen=True)
class DepthView:
    """A depth image, and the pose of the object relative to its camera.

    Attributes:
        scene: name of the scene.
        depth_m: 0 = not measured, which is no evidence.
    """

    scene: str
    intrinsics: Intrinsics
    camera_from_object: Transform
    depth_m: DepthImage


def witnesses(points: Points, views: Sequence[DepthView], *, margin_m: float) -> Int64[np.ndarray, " n"]:
    """Count, for each point, the views that see through it.

    Args:
        points: object frame.
        margin_m: by how much the measured depth must exceed that of the point.
    """
    count = np.zeros(len(points), np.int64)
    for view in views:
        in_camera = transform(view.camera_from_object, points)
        depth_m = _farthest_certain(view.depth_m)
        ahead = np.flatnonzero(in_camera[:, 2] > NEAREST_M)
        pixel = np.round(project(view.intrinsics, in_camera[ahead])).astype(np.int64)
        within = ((pixel >= 0) & (pixel < [view.intrinsics.width, view.intrinsics.height])).all(axis=1)
        ahead, (u, v) = ahead[within], pixel[within].T
        count[ahead] += depth_m[v, u] > in_camera[ahead, 2] + margin_m
    return count


def seen_through(
    points: Points, views: Sequence[DepthView], *, margin_m: float = MARGIN_M
) -> Bool[np.ndarray, " n"]:
    """Which points are free, as `WITNESSES` views see through them; points and views are in one frame."""
    free: Bool[np.ndarray, " n"] = witnesses(points, views, margin_m=margin_m) >= WITNESSES
    return free


def _farthest_certain(depth_m: DepthImage) -> DepthImage:
    """The nearest depth within a pixel of each; 0 beside pixels without depth, where sensors smear edges."""
    nearest: DepthImage = cv2.erode(depth_m, np.ones((3, 3), np.uint8))
    return nearest


def free_share(mesh: Mesh, views: Sequence[DepthView]) -> float:
    """Share of a mesh's area that lies in free space, where the object cannot be."""
    corners = mesh.vertices[mesh.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    free = seen_through(corners.mean(axis=1), views)
    return float(area[free].sum() / max(area.sum(), 1e-12))


def unseen_border(
    facets: Float64[np.ndarray, "f 4"], points: Points, views: Sequence[DepthView]
) -> PointCloud:
    """The border of the space that the object can fill: inside its convex hull, and not free.

    Args:
        facets: of the convex hull; ``normal @ p + offset <= 0`` inside.
        points: corners of the hull.
        views: empty = the border of the hull itself, at the resolution of the cells.

    Returns:
        Points with normals that point out of that space, about `CELL_M` apart.
    """
    low = points.min(axis=0) - 2 * CELL_M
    size = np.ceil((points.max(axis=0) + 2 * CELL_M - low) / CELL_M).astype(np.int64) + 1
    cells = np.indices(size).reshape(3, -1).T * CELL_M + low
    filled = (cells @ facets[:, :3].T + facets[:, 3]).max(axis=1) < 1e-6
    filled[filled] = ~seen_through(cells[filled], views)
    return border(filled.reshape(size), low)


def border(
    filled: Bool[np.ndarray, "x y z"], low: Float64[np.ndarray, "3"], *, cell_m: float = CELL_M
) -> PointCloud:
    """The outermost filled cells, each shifted to where the smoothed filling falls to one half."""
    smooth = ndimage.gaussian_filter(filled.astype(float), 1.0)
    edge = filled & ~ndimage.binary_erosion(filled)
    slope = np.stack(np.gradient(smooth), axis=-1)[edge]
    steepness = np.linalg.norm(slope, axis=1)
    clear = steepness > 1e-6
    outwards = -slope[clear] / steepness[clear, None]
    beyond = (smooth[edge][clear] - 0.5) / np.maximum(steepness[clear], 0.05)
    cells = np.argwhere(edge)[clear] + outwards * np.clip(beyond, -1, 1)[:, None]
    return PointCloud(low + cell_m * cells, outwards)


def view_of(
    scene: str,
    intrinsics: Intrinsics,
    scene_from_camera: Transform,
    scene_from_object: Transform,
    depth_m: DepthImage,
) -> DepthView:
    """Make the view of an object from a frame's depth image, its camera pose and the object's pose."""
    return DepthView(scene, intrinsics, invert(scene_from_camera) @ scene_from_object, depth_m)
