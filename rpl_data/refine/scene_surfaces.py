"""An object's surface as one scene saw it, ready to be compared with what the other scenes saw."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import cKDTree

from rpl_data.geometry import Transform, transform
from rpl_data.refine.colour import Texture, texture_of
from rpl_data.types import PointCloud

SPACING_M = 0.004
"""One point per cube of this size asks the other scenes, or fewer on large objects:"""
MOST_ASKING = 1200
RIM_M = 0.008
"""Points whose neighbours within this radius lie to one side are the rim of what was seen."""
SAME_WAY_RAD = 0.6
"""Largest angle between the normals of two points that may be the same place."""
BESIDE_M = 0.004
"""Largest distance between the two along the surface: farther off, the place itself was not seen."""


@dataclass(frozen=True)
class SceneSurface:
    """The grown region of one scene, scene frame.

    Attributes:
        cloud: points with normals, and colours where known.
        tree: of the points.
        asking: numbers of the points that look for their counterpart in other scenes.
        spacing_m: distance between these.
        rim: whether a point lies at the border of what was seen, where its normal is unreliable.
        texture: the print at the points.
    """

    cloud: PointCloud
    tree: cKDTree
    asking: Int64[np.ndarray, " q"]
    spacing_m: float
    rim: Bool[np.ndarray, " n"]
    texture: Texture

    def asked_by(self, chosen: Bool[np.ndarray, " q"]) -> SceneSurface:
        """The same surface, of which only some of the asking points ask."""
        return replace(self, asking=self.asking[chosen])


class Matches(NamedTuple):
    """Points of one surface and what they found in another one.

    Attributes:
        asking: which of the asking points (positions in `asking`).
        found: the nearest points of the other surface.
        points_b: the asking points, in the other scene's frame.
        distance_m: how far each lies before the other surface, along the other's normal.
    """

    asking: Int64[np.ndarray, " m"]
    found: Int64[np.ndarray, " m"]
    points_b: Float64[np.ndarray, "m 3"]
    distance_m: Float64[np.ndarray, " m"]


def scene_surface(cloud: PointCloud) -> SceneSurface:
    """Prepare a region for comparison.

    Args:
        cloud: points of the object's surface, scene frame, normals outwards.
    """
    spacing_m = SPACING_M
    asking = _one_per_cube(cloud, spacing_m)
    if len(asking) > MOST_ASKING:  # a surface has as many points as its area has squares
        spacing_m *= float(np.sqrt(len(asking) / MOST_ASKING))
        asking = _one_per_cube(cloud, spacing_m)
    tree = cKDTree(cloud.points)
    return SceneSurface(cloud, tree, asking, spacing_m, _rim(cloud, tree), texture_of(cloud))


def _one_per_cube(cloud: PointCloud, edge_m: float) -> Int64[np.ndarray, " q"]:
    cube = np.floor(cloud.points / edge_m).astype(np.int64)
    return np.unique(cube, axis=0, return_index=True)[1].astype(np.int64)


def _rim(cloud: PointCloud, tree: cKDTree) -> Bool[np.ndarray, " n"]:
    """Points whose neighbours' mean lies off to one side, along the surface."""
    pairs = tree.query_pairs(RIM_M, output_type="ndarray")
    count, offset = len(cloud.points), cloud.points[pairs[:, 1]] - cloud.points[pairs[:, 0]]
    mean = (
        np.column_stack(
            [
                np.bincount(pairs[:, 0], column, count) - np.bincount(pairs[:, 1], column, count)
                for column in offset.T
            ]
        )
        / np.maximum(np.bincount(pairs.ravel(), minlength=count), 1)[:, None]
    )
    mean -= (mean * cloud.normals).sum(axis=1)[:, None] * cloud.normals
    rim: Bool[np.ndarray, " n"] = np.linalg.norm(mean, axis=1) > 0.35 * RIM_M
    return rim


def match(a: SceneSurface, b: SceneSurface, b_from_a: Transform, *, gate_m: float) -> Matches:
    """Nearest points of b for the asking points of a, where the two can be the same place.

    Args:
        gate_m: farther counterparts are not believed.
    """
    asking = np.flatnonzero(~a.rim[a.asking])
    points = transform(b_from_a, a.cloud.points[a.asking[asking]])
    distance, nearest = b.tree.query(points, distance_upper_bound=gate_m)
    near = np.flatnonzero(np.isfinite(distance))
    near = near[~b.rim[nearest[near]]]
    asking, points, nearest = asking[near], points[near], nearest[near].astype(np.int64)
    normals_b = b.cloud.normals[nearest]
    offset = points - b.cloud.points[nearest]
    before = (offset * normals_b).sum(axis=1)
    beside = offset - before[:, None] * normals_b
    normals = a.cloud.normals[a.asking[asking]] @ b_from_a[:3, :3].T
    same_way = (normals * normals_b).sum(axis=1) > np.cos(SAME_WAY_RAD)
    kept = same_way & ((beside**2).sum(axis=1) < BESIDE_M**2)
    return Matches(asking[kept], nearest[kept], points[kept], before[kept])


def print_differences(a: SceneSurface, b: SceneSurface, matches: Matches) -> Float64[np.ndarray, "m c"]:
    """Print of b at the matched points minus that of a; b's is continued along its gradient."""
    offset = matches.points_b - b.cloud.points[matches.found]
    there = b.texture.values[matches.found] + np.einsum(
        "mcx,mx->mc", b.texture.gradients[matches.found], offset
    )
    difference: Float64[np.ndarray, "m c"] = there - a.texture.values[a.asking[matches.asking]]
    return difference
