"""Region growing as the Point Cloud Library does it, from given seeds (paper III-D).

pcl::RegionGrowing (Rabbani, van den Heuvel and Vosselman, "Segmentation of point clouds using smoothness
constraint", ISPRS 2006) spreads from a point to those of its k nearest neighbours whose normals differ by
less than an angle; where the surface bends too much, a region takes a point but does not spread from it.
The paper's change: the keypoints are the seeds. It prints no thresholds; those below are what the authors'
program has (RapidPoseLabels, `src/utils/region_growing.py` and `partial_model.py`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import cKDTree

from rpl_data.geometry import Points

NEIGHBOURS = 30
REACH_M = 0.01
"""A neighbour lies at most this far away."""
MAX_ANGLE_RAD = math.radians(5)
MAX_CURVATURE = 1.0
"""Of a point that a region spreads from. Curvature as PCL measures it is at most 1/3: this lets all pass."""
MOST_POINTS = 1000
"""A region stops to grow with so many points."""


class _Surface(NamedTuple):
    """What a region spreads by.

    Attributes:
        neighbours: numbers of the nearest points; the point itself where there are fewer.
        smooth: whether the normals of the point and of its neighbour agree.
        flat: whether a region spreads from the point.
    """

    neighbours: Int64[np.ndarray, "n k"]
    smooth: Bool[np.ndarray, "n k"]
    flat: Bool[np.ndarray, " n"]


def grow_from_seeds(
    points: Points,
    seeds: Float64[np.ndarray, "m 3"],
    *,
    neighbours: int = NEIGHBOURS,
    reach_m: float = REACH_M,
    max_angle_rad: float = MAX_ANGLE_RAD,
    max_curvature: float = MAX_CURVATURE,
    most_points: int = MOST_POINTS,
) -> Bool[np.ndarray, " n"]:
    """Which points lie in a region grown from one of the seeds; the seeds need not be among the points.

    Args:
        neighbours: how many nearest points a region may spread to, by which normals are estimated, too.
        max_angle_rad: largest angle between the normals of neighbours.
        max_curvature: largest surface variation (smallest eigenvalue of the neighbourhood over their sum,
            Pauly et al. 2002; 0 to 1/3) of a point that a region spreads from.
        most_points: a region that has as many spreads no farther.
    """
    every = np.concatenate([points, seeds])
    near = _nearest(every, neighbours, reach_m)
    normals, curvature = _normals_and_curvature(every, near)
    smooth = np.abs(np.einsum("nd,nkd->nk", normals, normals[near])) >= np.cos(max_angle_rad)
    surface = _Surface(near, smooth, curvature <= max_curvature)
    reached = np.zeros(len(every), bool)
    for seed in range(len(points), len(every)):
        reached |= _region(surface, seed, most_points)
    return reached[: len(points)]


def _nearest(points: Points, count: int, reach_m: float) -> Int64[np.ndarray, "n k"]:
    """Numbers of the nearest points within reach, itself first and wherever there are fewer."""
    _, near = cKDTree(points).query(points, k=count, distance_upper_bound=reach_m)
    itself = np.arange(len(points))[:, None]
    return np.where(near < len(points), near, itself).astype(np.int64)


def _normals_and_curvature(
    points: Points, near: Int64[np.ndarray, "n k"]
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, " n"]]:
    """Unit normals of either sign, and surface variation, by the principal axes of the neighbourhoods."""
    counted = near != np.arange(len(points))[:, None]
    counted[:, 0] = True
    weights = counted / counted.sum(axis=1, keepdims=True)
    centre = np.einsum("nk,nkd->nd", weights, points[near])
    offset = points[near] - centre[:, None]
    spread, axes = np.linalg.eigh(np.einsum("nk,nkd,nke->nde", weights, offset, offset))
    return axes[:, :, 0], spread[:, 0].clip(0) / np.maximum(spread.sum(axis=1), 1e-15)


def _region(surface: _Surface, seed: int, most_points: int) -> Bool[np.ndarray, " n"]:
    """The points that a region reaches from a seed, neighbours of neighbours one ring after another."""
    reached = np.zeros(len(surface.flat), bool)
    reached[seed] = True
    ring = np.array([seed])
    while len(ring) and reached.sum() < most_points:
        found = np.unique(surface.neighbours[ring][surface.smooth[ring]])
        found = found[~reached[found]]
        reached[found] = True
        ring = found[surface.flat[found]]
    return reached
