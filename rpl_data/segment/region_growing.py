"""What region growing on surfaces is made of: oriented points, planes, regions, which side is seen.

Everything here works on points with unit normals that point out of the surface, in one frame.
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


@dataclass(frozen=True)
class Plane:
    """Points p with ``normal @ p == offset_m``; the normal points to the side that was seen."""

    normal: Float64[np.ndarray, "3"]
    offset_m: float

    def height_m(self, points: Points) -> Float64[np.ndarray, " n"]:
        """Signed distance of points, positive on the seen side."""
        height: Float64[np.ndarray, " n"] = points @ self.normal - self.offset_m
        return height


def smooth_or_convex_pairs(
    cloud: PointCloud, *, radius_m: float, max_concave_rad: float
) -> Int64[np.ndarray, "m 2"]:
    """Neighbour pairs a region may grow across.

    An object's own edges are mostly convex, its contact with what it stands on is concave (LCCP,
    Stein et al., CVPR 2014). Two oriented points are joined over a concave edge when the nearer
    one along its normal sees the other in front of it: ``(n_a - n_b) @ (p_a - p_b) < 0``.

    Args:
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
    """Number of the connected component of each of `count` points."""
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
    """Planes the object stands on or before: large, and all keypoints on their seen side.

    An object's own flat faces never qualify: its other keypoints lie behind them. Neither does the
    floor of a bowl: a plane must reach beyond the keypoints.

    Args:
        tolerance_m: distance from the plane up to which a point lies on it.
        keypoint_tolerance_m: how far a keypoint may lie behind it.
        min_share: least share of the points.
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
        on = _on_plane(best, rest, tolerance_m)
        if on.sum() < least:
            break
        if np.median(np.linalg.norm(rest.points[on] - centre, axis=1)) > reach_m:
            planes.append(_refined(best, rest.points[on]))
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
    """RANSAC over triples of points, only planes with all keypoints on their seen side."""
    triples = cloud.points[generator.integers(0, len(cloud.points), (hypotheses, 3))]
    seen_side = cloud.normals[generator.integers(0, len(cloud.points), hypotheses)]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    length = np.linalg.norm(normals, axis=1)
    normals = normals[length > 1e-6] / length[length > 1e-6, None]
    del seen_side
    offsets = (normals * triples[length > 1e-6, 0]).sum(axis=1)
    heights = keypoints @ normals.T - offsets  # k x h
    sign = np.where(heights.mean(axis=0) >= 0, 1.0, -1.0)
    possible = (heights * sign).min(axis=0) > -keypoint_tolerance_m
    best, best_count = None, 0
    for normal, offset in zip((normals * sign[:, None])[possible], (offsets * sign)[possible], strict=True):
        plane = Plane(normal, float(offset))
        count = int(_on_plane(plane, cloud, tolerance_m).sum())
        if count > best_count:
            best, best_count = plane, count
    return best


def _on_plane(plane: Plane, cloud: PointCloud, tolerance_m: float) -> Bool[np.ndarray, " n"]:
    on: Bool[np.ndarray, " n"] = (np.abs(plane.height_m(cloud.points)) < tolerance_m) & (
        cloud.normals @ plane.normal > 0.8
    )
    return on


def _refined(plane: Plane, points: Points) -> Plane:
    """Least-squares plane of the points, facing as before."""
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    normal = normal * np.sign(normal @ plane.normal)
    return Plane(normal, float(normal @ centre))


def beyond_footprint_m(
    plane: Plane, shape: Points, points: Float64[np.ndarray, "m 3"]
) -> Float64[np.ndarray, " m"]:
    """How far points lie outside the convex footprint of a shape on a plane; negative inside."""
    axes = np.linalg.svd(plane.normal[None])[2][1:]
    corners = shape @ axes.T
    if len(corners) < 3 or np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)[1] < 1e-6:
        return np.full(len(points), -np.inf)  # no area to compare with: nothing is known to be outside
    edges = ConvexHull(corners).equations
    beyond: Float64[np.ndarray, " n"] = (points @ axes.T @ edges[:, :2].T + edges[:, 2]).max(axis=1)
    return beyond


def height_above(
    surface: PointCloud, tree: cKDTree, points: Points, *, max_tilt: float = 0.7
) -> Float64[np.ndarray, " n"]:
    """How far points float before the surface; 0 or less behind it, NaN beside its border.

    From the nearest surface point: a point straight along its normal is in space the camera saw
    through; one that lies sideways of it is beyond where the surface was seen, so nothing is known.

    Args:
        max_tilt: cosine of the angle to the normal from which a point is 'straight above'.
    """
    distance, nearest = tree.query(points)
    along: Float64[np.ndarray, " n"] = ((points - surface.points[nearest]) * surface.normals[nearest]).sum(
        axis=1
    )
    return np.where(np.abs(along) >= max_tilt * distance - 1e-9, along, np.nan)
