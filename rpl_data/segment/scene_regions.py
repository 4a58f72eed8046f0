"""The object's regions in each scene's surface, grown from its keypoints, without what it stands on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.spatial import cKDTree

from rpl_data.geometry import Points, invert, transform
from rpl_data.meshes import oriented_points, select, smoothed_normals, thinned
from rpl_data.segment.region_growing import (
    NEAR_M,
    CropBox,
    Plane,
    beyond_support_halo,
    box_around_keypoints,
    components,
    inside,
    planes_below,
    smooth_or_convex_pairs,
)
from rpl_data.types import Mesh, PointCloud, Solution


@dataclass(frozen=True)
class Surroundings:
    """One scene's surface around the object, in the object frame.

    Attributes:
        surface: all points near the object.
        planes: what the object stands on or in front of.
        above: the points that are not on those planes.
    """

    surface: PointCloud
    planes: list[Plane]
    above: PointCloud


def grown_regions(
    surfaces: Mapping[str, Mesh],
    solution: Solution,
    *,
    voxel_m: float = 0.003,
    crop_m: CropBox | None = None,
) -> dict[str, PointCloud]:
    """The object's surface as each scene saw it, in the object frame, without its support.

    Args:
        surfaces, voxel_m, crop_m: as in `segment_object`.

    Returns:
        By scene name; scenes without a surface at the keypoints are absent.
    """
    surroundings = all_surroundings(surfaces, solution, voxel_m, crop_m)
    return regions(surroundings, solution.model.points_object[solution.model.known], voxel_m)


def all_surroundings(
    surfaces: Mapping[str, Mesh], solution: Solution, voxel_m: float, crop_m: CropBox | None
) -> dict[str, Surroundings]:
    """The surroundings of the object, by scene; scenes not placed or without a surface there are absent."""
    keypoints = solution.model.points_object[solution.model.known]
    surroundings: dict[str, Surroundings] = {}
    for scene, mesh in surfaces.items():
        if scene in solution.scene_from_object:
            surface = _near_object(mesh, solution.scene_from_object[scene], keypoints, voxel_m, crop_m)
            if len(surface.points) >= 50:
                planes = planes_below(surface, keypoints)
                surroundings[scene] = Surroundings(surface, planes, _without_planes(surface, planes))
    return surroundings


def regions(
    surroundings: Mapping[str, Surroundings], keypoints: Points, voxel_m: float
) -> dict[str, PointCloud]:
    """The regions grown from the keypoints, by scene; empty ones are absent."""
    grown = {
        scene: _without_support_halo(_grow(around.above, keypoints, voxel_m), around.planes, keypoints)
        for scene, around in surroundings.items()
    }
    return {scene: region for scene, region in grown.items() if len(region.points)}


def _near_object(
    mesh: Mesh,
    scene_from_object: Float64[np.ndarray, "4 4"],
    keypoints: Points,
    voxel_m: float,
    crop_m: CropBox | None,
) -> PointCloud:
    """Points of the surface around the keypoints, in the object frame, with smoothed normals."""
    moved = Mesh(transform(invert(scene_from_object), mesh.vertices), mesh.triangles, mesh.colors)
    cloud = oriented_points(moved)
    low, high = box_around_keypoints(keypoints)
    near = np.all((cloud.points > low) & (cloud.points < high), axis=1)
    if crop_m is not None:
        near &= inside(cloud.points, crop_m)
    return smoothed_normals(thinned(select(cloud, near), voxel_m=voxel_m * 0.7), radius_m=2 * voxel_m)


def _without_planes(cloud: PointCloud, planes: list[Plane], *, band_m: float = 0.006) -> PointCloud:
    """The points in front of all planes; near a plane, only those whose normal differs from the plane's."""
    kept = np.ones(len(cloud.points), bool)
    for plane in planes:
        height = plane.height_m(cloud.points)
        kept &= (height > band_m) | ((height > 0.002) & (cloud.normals @ plane.normal < 0.75))
    return select(cloud, kept)


def _grow(cloud: PointCloud, keypoints: Points, voxel_m: float) -> PointCloud:
    """The regions of one scene that the keypoints lie on (the paper's modified region growing)."""
    if not len(cloud.points):
        return cloud
    pairs = smooth_or_convex_pairs(cloud, radius_m=2.0 * voxel_m, max_concave_rad=0.35)
    region = components(len(cloud.points), pairs)
    seeds = np.unique(np.concatenate(cKDTree(cloud.points).query_ball_point(keypoints, NEAR_M)))
    seeded = np.bincount(region[seeds.astype(int)], minlength=region.max() + 1)
    size = np.bincount(region)
    return select(cloud, (seeded > 0)[region] & (size > 20)[region])


def _without_support_halo(region: PointCloud, planes: list[Plane], keypoints: Points) -> PointCloud:
    """Remove the support halo: points of the table around the object, raised by noise or smoothing."""
    kept = np.ones(len(region.points), bool)
    for plane in planes:
        kept &= beyond_support_halo(region.points, plane, keypoints)
    return select(region, kept)
