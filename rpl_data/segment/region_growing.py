"""Planes, connected regions and visibility tests on oriented points, for region growing.

All points are in one frame and have unit normals that point out of the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, cKDTree

from rpl_data.geometry import Points
from rpl_data.meshes import select, thinned
from rpl_data.types import PointCloud

NEAR_M = 0.008
"""A keypoint this near to a surface lies on it: regions grow from there."""

CropBox = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lowest and highest corner, metres: what lies outside is cut off."""


@dataclass(frozen=True)
class Plane:
    """The points p with ``normal @ p == offset_m``; the normal points to the side that was seen."""

    normal: Float64[np.ndarray, "3"]
    offset_m: float

    def height_m(self, points: Points) -> Float64[np.ndarray, " n"]:
        """Signed distance of points, positive on the seen side."""
        height: Float64[np.ndarray, " n"] = points @ self.normal - self.offset_m
        return height


def box_around_keypoints(keypoints: Points) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """The lowest and the highest corner of a box that holds the object and some of its support."""
    low, high = keypoints.min(axis=0), keypoints.max(axis=0)
    margin_m = max(0.6 * float(np.linalg.norm(high - low)), 0.06)
    return low - margin_m, high + margin_m


def inside(points: Points, box: CropBox) -> Bool[np.ndarray, " n"]:
    """Which points lie inside a box in their frame."""
    low, high = box
    return np.asarray(((points > low) & (points < high)).all(axis=1))


def smooth_or_convex_pairs(
    cloud: PointCloud, *, radius_m: float, max_concave_rad: float
) -> Int64[np.ndarray, "m 2"]:
    """Find the pairs of neighbouring points that a region may grow across: smooth or convex ones.

    An object's own edges are mostly convex, while its contact with the support is concave (LCCP, Stein et
    al., CVPR 2014). An edge between two oriented points is convex where ``(n_a - n_b) @ (p_a - p_b) > 0``.

    Args:
        radius_m: largest distance between neighbours.
        max_concave_rad: angle between the normals up to which a concave pair counts as smooth.
    """
    pairs = cKDTree(cloud.points).query_pairs(radius_m, output_type="ndarray")
    a, b = pairs[:, 0], pairs[:, 1]
    normal_a, normal_b = cloud.normals[a], cloud.normals[b]
    smooth = (normal_a * normal_b).sum(axis=1) > np.cos(max_concave_rad)
    convex = ((normal_a - normal_b) * (cloud.points[a] - cloud.points[b])).sum(axis=1) > 0
    kept: Int64[np.ndarray, "m 2"] = pairs[smooth | convex].astype(np.int64)
    return kept


def components(count: int, pairs: Int64[np.ndarray, "m 2"]) -> Int64[np.ndarray, " n"]:
    """The number of the connected component that each of `count` points belongs to."""
    graph = coo_matrix((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    labels: Int64[np.ndarray, " n"] = connected_components(graph, directed=False)[1].astype(np.int64)
    return labels


def planes_below(
    cloud: PointCloud,
    keypoints: Points,
    *,
    tolerance_m: float = 0.004,
    keypoint_tolerance_m: float = 0.008,
    min_share: float = 0.08,
    max_planes: int = 4,
    hypotheses: int = 600,
    seed: int = 0,
) -> list[Plane]:
    """Find the planes that the object stands on or in front of: large, with all keypoints on their seen side.

    An object's own flat faces never qualify, since its other keypoints lie behind them. Neither does the
    floor of a bowl, since a plane must reach beyond the keypoints.

    Args:
        tolerance_m: distance from the plane up to which a point lies on it.
        keypoint_tolerance_m: how far a keypoint may lie behind it.
        min_share: smallest share of the points that must lie on a plane.
        hypotheses: planes tried per search.
    """
    generator = np.random.default_rng(seed)
    centre = keypoints.mean(axis=0)
    reach_m = np.linalg.norm(keypoints - centre, axis=1).max()
    rest = thinned(cloud, voxel_m=0.006)
    least = max(min_share * len(rest.points), 30)
    planes: list[Plane] = []
    while len(planes) < max_planes and len(rest.points) > least:
        best = _best_plane(rest, keypoints, tolerance_m, keypoint_tolerance_m, hypotheses, generator)
        if best is None:
            break
        on = on_plane(best, rest, tolerance_m)
        if on.sum() < least:
            break
        if np.median(np.linalg.norm(rest.points[on] - centre, axis=1)) > reach_m:
            planes.append(least_squares_plane(best, rest.points[on]))
        rest = select(rest, ~on)
    return planes


def _best_plane(
    cloud: PointCloud,
    keypoints: Points,
    tolerance_m: float,
    keypoint_tolerance_m: float,
    hypotheses: int,
    generator: np.random.Generator,
) -> Plane | None:
    """The plane with most points (RANSAC over triples) among those with all keypoints on one side of it."""
    triples = cloud.points[generator.integers(0, len(cloud.points), (hypotheses, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    length = np.linalg.norm(normals, axis=1)
    normals = normals[length > 1e-6] / length[length > 1e-6, None]
    offsets = (normals * triples[length > 1e-6, 0]).sum(axis=1)
    heights = keypoints @ normals.T - offsets  # k x h
    sign = np.where(heights.mean(axis=0) >= 0, 1.0, -1.0)
    possible = (heights * sign).min(axis=0) > -keypoint_tolerance_m
    best, best_count = None, 0
    for normal, offset in zip((normals * sign[:, None])[possible], (offsets * sign)[possible], strict=True):
        plane = Plane(normal, float(offset))
        count = int(on_plane(plane, cloud, tolerance_m).sum())
        if count > best_count:
            best, best_count = plane, count
    return best


def on_plane(
    plane: Plane, cloud: PointCloud, tolerance_m: float, *, least_cosine: float = 0.8
) -> Bool[np.ndarray, " n"]:
    """Which points lie on the plane and face the same way."""
    on: Bool[np.ndarray, " n"] = (np.abs(plane.height_m(cloud.points)) < tolerance_m) & (
        cloud.normals @ plane.normal > least_cosine
    )
    return on


def least_squares_plane(plane: Plane, points: Points) -> Plane:
    """Fit a plane to the points, with its normal on the same side as that of `plane`."""
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    normal = normal * np.sign(normal @ plane.normal)
    return Plane(normal, float(normal @ centre))


def beyond_footprint_m(
    plane: Plane, shape: Points, points: Float64[np.ndarray, "m 3"]
) -> Float64[np.ndarray, " m"]:
    """Distance of points from the convex footprint of a shape on a plane; negative inside it."""
    axes = np.linalg.svd(plane.normal[None])[2][1:]
    corners = shape @ axes.T
    if len(corners) < 3 or np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)[1] < 1e-6:
        return np.full(len(points), -np.inf)  # without an area, no point can be called outside
    edges = ConvexHull(corners).equations
    beyond: Float64[np.ndarray, " n"] = (points @ axes.T @ edges[:, :2].T + edges[:, 2]).max(axis=1)
    return beyond


def beyond_support_halo(
    points: Float64[np.ndarray, "m 3"],
    plane: Plane,
    keypoints: Points,
    *,
    low_m: float = 0.02,
    reach_m: float = 0.008,
) -> Bool[np.ndarray, " m"]:
    """Which points are the object's, not the halo's: low ones around it, where its support seems raised.

    Low points are kept only within `reach_m` of the footprint of the higher points and the keypoints.
    """
    height = plane.height_m(points)
    limit_m = min(low_m, 0.3 * float(plane.height_m(keypoints).max()))
    upper = np.concatenate([points[height > limit_m], keypoints])
    kept: Bool[np.ndarray, " m"] = (height > limit_m) | (beyond_footprint_m(plane, upper, points) < reach_m)
    return kept


def height_above(
    surface: PointCloud, tree: cKDTree, points: Points, *, least_cosine: float = 0.7
) -> Float64[np.ndarray, " n"]:
    """Height of points in front of the surface; 0 or less behind it, NaN beside its border.

    The height is measured along the normal of the nearest surface point. A point straight above the surface
    is in space that the camera saw through; one beside its border is where nothing was seen.

    Args:
        tree: of the points of the surface.
        least_cosine: of the angle to the normal, at which a point still counts as straight above.
    """
    distance, nearest = tree.query(points)
    along: Float64[np.ndarray, " n"] = ((points - surface.points[nearest]) * surface.normals[nearest]).sum(
        axis=1
    )
    return np.where(np.abs(along) >= least_cosine * distance - 1e-9, along, np.nan)
