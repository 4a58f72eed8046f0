"""From the scenes' surfaces and the sparse model to the dense model of the object (paper III-D)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import cKDTree

from rpl_data.geometry import Points, invert, transform
from rpl_data.meshes import joined, oriented_points, select, smoothed_normals, thinned
from rpl_data.segment.completion import closed_mesh
from rpl_data.segment.free_space import DepthView, free_share, witnesses
from rpl_data.segment.region_growing import (
    Plane,
    beyond_footprint_m,
    components,
    height_above,
    planes_below,
    smooth_or_convex_pairs,
)
from rpl_data.types import DataError, Mesh, PointCloud, Solution

CropBox = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lowest and highest corner in the object frame, metres."""


@dataclass(frozen=True)
class DenseModel:
    """The object's surface in the object frame.

    Attributes:
        mesh: closed, for masks. cloud: only what was seen.
        seen: whether each triangle lies on surface that was seen; the others close unseen sides.
        open_edges: edges without exactly two triangles; 0 = the mesh is watertight.
        free_share: share of the mesh's area in space that depth images saw through, which is false; NaN
            where no depth image was given.
        warnings: lines for a person.
    """

    mesh: Mesh
    cloud: PointCloud
    seen: Bool[np.ndarray, " m"]
    open_edges: int
    free_share: float
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class _View:
    """One scene's surface in the object frame, cut to the surroundings of the object."""

    surface: PointCloud
    planes: list[Plane]
    above: PointCloud  # without what the object stands on


def segment_object(
    surfaces: Mapping[str, Mesh],
    solution: Solution,
    *,
    voxel_m: float = 0.003,
    crop_m: CropBox | None = None,
    depth_views: Sequence[DepthView] = (),
) -> DenseModel:
    """The dense model: regions grown from the keypoints in each scene's surface, merged and closed.

    1. every scene's surface is brought to the object frame and cut to the keypoints' surroundings;
    2. planes with all keypoints before them (table, wall) are removed;
    3. regions grow from the keypoints over smooth and convex places;
    4. what other scenes saw through is removed; the rest is merged and closed.

    Args:
        surfaces: scene frame, by scene name; scenes the solution does not place are not used.
        voxel_m: resolution of the surfaces.
        crop_m: lowest and highest corner of a box in the object frame; everything outside is cut.
        depth_views: depth images of the scenes, which tell where the object is not.

    Raises:
        DataError: no scene is placed, or no surface is found at the keypoints.
    """
    keypoints = solution.model.points_object[solution.model.known]
    views = _views(surfaces, solution, voxel_m, crop_m)
    grown = _grown(views, keypoints, voxel_m)
    if not grown:
        raise DataError(
            f"object {solution.model.name}: none of {len(surfaces)} scene surfaces has points at the "
            "keypoints; expected a surface there; check the clicks and the trajectories, and that depth is "
            "measured there at all (dark and shiny parts give none): film such a part nearer or longer"
        )
    agreed = [
        _not_seen_through(region, scene, views, depth_views, voxel_m) for scene, region in grown.items()
    ]
    cloud = _around_keypoints(thinned(joined(agreed), voxel_m=voxel_m * 0.7), keypoints, voxel_m)
    anchors = np.concatenate([keypoints, _contact_points(cloud, views)])
    warnings = tuple(
        f"scene {scene} has no surface at the keypoints" for scene in surfaces if scene not in grown
    )
    closed = closed_mesh(cloud, anchors, voxel_m=voxel_m, views=depth_views)
    share = free_share(closed.mesh, depth_views) if depth_views else float("nan")
    return DenseModel(closed.mesh, cloud, closed.seen, closed.open_edges, share, warnings)


def grown_regions(
    surfaces: Mapping[str, Mesh],
    solution: Solution,
    *,
    voxel_m: float = 0.003,
    crop_m: CropBox | None = None,
) -> dict[str, PointCloud]:
    """The object's surface as each scene saw it, in the object frame, without what the object stands on.

    Args:
        surfaces, voxel_m, crop_m: as in `segment_object`.

    Returns:
        By scene; those without a surface at the keypoints are left out.
    """
    views = _views(surfaces, solution, voxel_m, crop_m)
    return _grown(views, solution.model.points_object[solution.model.known], voxel_m)


def _views(
    surfaces: Mapping[str, Mesh], solution: Solution, voxel_m: float, crop_m: CropBox | None
) -> dict[str, _View]:
    """The surroundings of the object in every scene that is placed and has a surface there."""
    keypoints = solution.model.points_object[solution.model.known]
    views: dict[str, _View] = {}
    for scene, mesh in surfaces.items():
        if scene in solution.scene_from_object:
            surface = _near_object(mesh, solution.scene_from_object[scene], keypoints, voxel_m, crop_m)
            if len(surface.points) >= 50:
                planes = planes_below(surface, keypoints)
                views[scene] = _View(surface, planes, _without_planes(surface, planes))
    return views


def _grown(views: Mapping[str, _View], keypoints: Points, voxel_m: float) -> dict[str, PointCloud]:
    """The regions grown from the keypoints, by scene."""
    grown = {
        scene: _without_support_halo(_grow(view.above, keypoints, voxel_m), view.planes, keypoints)
        for scene, view in views.items()
    }
    return {scene: region for scene, region in grown.items() if len(region.points)}


def _near_object(
    mesh: Mesh,
    scene_from_object: Float64[np.ndarray, "4 4"],
    keypoints: Points,
    voxel_m: float,
    crop_m: CropBox | None,
) -> PointCloud:
    """Points of the surface around the keypoints, object frame, with smoothed normals."""
    moved = Mesh(transform(invert(scene_from_object), mesh.vertices), mesh.triangles, mesh.colors)
    cloud = oriented_points(moved)
    low, high = keypoints.min(axis=0), keypoints.max(axis=0)
    margin_m = max(0.6 * float(np.linalg.norm(high - low)), 0.06)
    inside = ((cloud.points > low - margin_m) & (cloud.points < high + margin_m)).all(axis=1)
    if crop_m is not None:
        inside &= ((cloud.points > crop_m[0]) & (cloud.points < crop_m[1])).all(axis=1)
    return smoothed_normals(thinned(select(cloud, inside), voxel_m=voxel_m * 0.7), radius_m=2 * voxel_m)


def _without_planes(cloud: PointCloud, planes: list[Plane], *, band_m: float = 0.006) -> PointCloud:
    """The points before all planes; near a plane only those that do not face the same way."""
    kept = np.ones(len(cloud.points), bool)
    for plane in planes:
        height = plane.height_m(cloud.points)
        kept &= (height > band_m) | ((height > 0.002) & (cloud.normals @ plane.normal < 0.75))
    return select(cloud, kept)


def _grow(
    cloud: PointCloud, keypoints: Points, voxel_m: float, *, seed_radius_m: float = 0.008
) -> PointCloud:
    """The regions of one scene that the keypoints lie on (the paper's modified region growing)."""
    if not len(cloud.points):
        return cloud
    pairs = smooth_or_convex_pairs(cloud, radius_m=2.0 * voxel_m, max_concave_rad=0.35)
    region = components(len(cloud.points), pairs)
    seeds = np.unique(np.concatenate(cKDTree(cloud.points).query_ball_point(keypoints, seed_radius_m)))
    seeded = np.bincount(region[seeds.astype(int)], minlength=region.max() + 1)
    size = np.bincount(region)
    return select(cloud, (seeded > 0)[region] & (size > 20)[region])


def _without_support_halo(
    region: PointCloud,
    planes: list[Plane],
    keypoints: Points,
    *,
    low_m: float = 0.02,
    reach_m: float = 0.008,
) -> PointCloud:
    """The region without its halo on the support: flat tails along the table, or bumps of its depth.

    Low points are kept only below or near points that stand higher, or the keypoints.
    """
    kept = np.ones(len(region.points), bool)
    for plane in planes:
        height = plane.height_m(region.points)
        limit_m = min(low_m, 0.3 * float(plane.height_m(keypoints).max()))
        upper = np.concatenate([region.points[height > limit_m], keypoints])
        kept &= (height > limit_m) | (beyond_footprint_m(plane, upper, region.points) < reach_m)
    return select(region, kept)


def _not_seen_through(
    region: PointCloud,
    own: str,
    views: Mapping[str, _View],
    depth_views: Sequence[DepthView],
    voxel_m: float,
    *,
    margin_m: float = 0.004,
) -> PointCloud:
    """The region without points that float before a surface seen in another scene (carving).

    Where another scene has depth images, one of them must also see through the point: a surface that was
    measured only in part has thin and dark parts of the object floating before it.
    """
    floating = np.zeros(len(region.points), bool)
    for scene, view in views.items():
        if scene != own:
            height = height_above(view.surface, cKDTree(view.surface.points), region.points)
            floating |= (height > max(0.006, 2 * voxel_m)) & (height < 0.05)
    others = [view for view in depth_views if view.scene != own]
    if others:
        floating[floating] = witnesses(region.points[floating], others, margin_m=margin_m) > 0
    return select(region, ~floating)


def _around_keypoints(
    cloud: PointCloud, keypoints: Points, voxel_m: float, *, seed_radius_m: float = 0.008
) -> PointCloud:
    """The pieces of the merged cloud that keypoints lie on, and large ones, without crumbs."""
    tree = cKDTree(cloud.points)
    pairs = tree.query_pairs(3 * voxel_m, output_type="ndarray").astype(np.int64)
    piece = components(len(cloud.points), pairs)
    size = np.bincount(piece)
    seeds = np.concatenate(tree.query_ball_point(keypoints, seed_radius_m)).astype(int)
    seeded = np.bincount(piece[seeds], minlength=len(size)) > 0
    kept: Bool[np.ndarray, " n"] = ((seeded & (size > 0.02 * len(piece))) | (size > 0.2 * len(piece)))[piece]
    return select(cloud, kept)


def _contact_points(
    cloud: PointCloud, views: Mapping[str, _View], *, reach_m: float = 0.012
) -> Float64[np.ndarray, "_ 3"]:
    """Where the object touches its support: its lowest points, moved down to the plane below it."""
    contact = [np.empty((0, 3))]
    for view in views.values():
        for plane in view.planes:
            height = plane.height_m(cloud.points)
            low = (height > -0.002) & (height < reach_m)
            contact.append(cloud.points[low] - height[low, None] * plane.normal)
    return np.concatenate(contact)
