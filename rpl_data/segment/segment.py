"""Segment the object from the scenes' surfaces by its keypoints: the dense model (paper III-D)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import cKDTree

from rpl_data.geometry import Points
from rpl_data.meshes import joined, select, thinned
from rpl_data.segment.carving import carved
from rpl_data.segment.completion import closed_mesh, mesh_of_border
from rpl_data.segment.free_space import DepthView, free_share, witnesses
from rpl_data.segment.mask_votes import MaskView, regions_by_masks
from rpl_data.segment.refusals import refuse_seen_through, refuse_without_surface
from rpl_data.segment.region_growing import (
    NEAR_M,
    CropBox,
    components,
    height_above,
)
from rpl_data.segment.scene_regions import Surroundings, all_surroundings, regions
from rpl_data.types import Mesh, PointCloud, Solution

LEAST_COVERED = 0.5
"""Where a smaller share of the keypoints lies on the grown regions, depth may have missed the object."""


@dataclass(frozen=True)
class DenseModel:
    """The object's surface in the object frame.

    Attributes:
        mesh: closed triangles, from which masks are rendered.
        cloud: points of the surface that was seen; of a carved model, of its border.
        seen: for each triangle, whether it lies on surface that was seen; the others close unseen sides.
        open_edges: edges without exactly two triangles; 0 = the mesh is watertight.
        free_share: share of the mesh's area in space that depth images saw through, where the object cannot
            be; NaN without depth images, and for a carved model, which ends where they saw through.
        warnings: lines for the user.
    """

    mesh: Mesh
    cloud: PointCloud
    seen: Bool[np.ndarray, " m"]
    open_edges: int
    free_share: float
    warnings: tuple[str, ...] = ()

    @property
    def carved(self) -> bool:
        """Whether no surface was measured: the shape is what outlines leave (`carving`)."""
        return not self.seen.any()


def segment_object(
    surfaces: Mapping[str, Mesh],
    solution: Solution,
    *,
    voxel_m: float = 0.003,
    crop_m: CropBox | None = None,
    depth_views: Sequence[DepthView] = (),
    mask_views: Sequence[MaskView] = (),
) -> DenseModel:
    """Make the dense model: grow regions from the keypoints in each scene's surface, merge and close them.

    1. Every scene's surface is transformed to the object frame and cropped around the keypoints.
    2. Planes with all keypoints in front of them (table, wall) are removed.
    3. Regions grow from the keypoints across smooth and convex edges.
    4. Points that other scenes saw through are removed; the rest is merged and closed.

    Where depth has holes in the object's place, regions hardly grow; it is then carved: see `carved`.

    Args:
        surfaces: by scene name, in the scene frame; scenes that the solution does not place are ignored.
        voxel_m: resolution of the surfaces.
        crop_m: lowest and highest corner of a box in the object frame; everything outside is cut.
        depth_views: depth images of the scenes, which show where space is free.
        mask_views: masks that another program made of the object, which vote on the surface of their scene.

    Raises:
        DataError: no scene is placed, or no surface is found at the keypoints that others do not see through.
    """
    keypoints = solution.model.points_object[solution.model.known]
    surroundings = all_surroundings(surfaces, solution, voxel_m, crop_m)
    grown = regions(surroundings, keypoints, voxel_m)
    above = {scene: around.above for scene, around in surroundings.items()}
    grown, said = regions_by_masks(grown, above, mask_views, keypoints)
    cloud = _merged(grown, surroundings, keypoints, depth_views, voxel_m) if grown else None
    if cloud is None or _covered_share(cloud, keypoints) < LEAST_COVERED:
        planes = [plane for around in surroundings.values() for plane in around.planes]
        border = carved(keypoints, planes, depth_views, voxel_m=voxel_m, crop_m=crop_m)
        if border is not None:
            return _unseen_model(border, voxel_m, masks_given=bool(mask_views))
    if cloud is None:
        refuse_without_surface(surfaces, solution, crop_m)
    if not len(cloud.points):
        refuse_seen_through(solution.model.name, list(grown))
    anchors = np.concatenate([keypoints, _contact_points(cloud, surroundings)])
    lacking = [f"scene {scene} has no surface at the keypoints" for scene in surfaces if scene not in grown]
    warnings = (*lacking, *said)
    closed = closed_mesh(cloud, anchors, voxel_m=voxel_m, views=depth_views)
    share = free_share(closed.mesh, depth_views) if depth_views else float("nan")
    return DenseModel(closed.mesh, cloud, closed.seen, closed.open_edges, share, warnings)


def _merged(
    grown: Mapping[str, PointCloud],
    surroundings: Mapping[str, Surroundings],
    keypoints: Points,
    depth_views: Sequence[DepthView],
    voxel_m: float,
) -> PointCloud:
    """The regions of all scenes as one cloud, without what other scenes saw through."""
    agreed = [
        _not_seen_through(region, scene, surroundings, depth_views, voxel_m)
        for scene, region in grown.items()
    ]
    return _around_keypoints(thinned(joined(agreed), voxel_m=voxel_m * 0.7), keypoints, voxel_m)


def _covered_share(cloud: PointCloud, keypoints: Points) -> float:
    """Share of the keypoints that lie on a cloud."""
    return float((cKDTree(cloud.points).query(keypoints)[0] < NEAR_M).mean())


def _unseen_model(border: PointCloud, voxel_m: float, *, masks_given: bool) -> DenseModel:
    """The dense model of an object of which no surface was measured: what no depth image saw through."""
    closed = mesh_of_border(border, voxel_m=voxel_m)
    warnings = [
        "hardly any depth is measured on it, so its dense model is the space that no depth image saw "
        "through: without colours, and too large where it is hollow or where no camera looked past it; more "
        "scenes, in which it lies on other sides, help"
    ]
    if masks_given:
        warnings.append("given masks vote on measured surface, of which it has none: they are not used")
    return DenseModel(closed.mesh, border, closed.seen, closed.open_edges, float("nan"), tuple(warnings))


def _not_seen_through(
    region: PointCloud,
    own: str,
    surroundings: Mapping[str, Surroundings],
    depth_views: Sequence[DepthView],
    voxel_m: float,
    *,
    margin_m: float = 0.004,
) -> PointCloud:
    """Remove points that float in front of a surface seen in another scene (space carving).

    Where other scenes have depth images, one of them must also see through the point: where a scene's surface
    lacks thin or dark parts of the object, they would seem to float in front of what lies behind them.
    """
    floating = np.zeros(len(region.points), bool)
    for scene, around in surroundings.items():
        if scene != own:
            height = height_above(around.surface, cKDTree(around.surface.points), region.points)
            floating |= (height > max(0.006, 2 * voxel_m)) & (height < 0.05)
    others = [view for view in depth_views if view.scene != own]
    if others:
        floating[floating] = witnesses(region.points[floating], others, margin_m=margin_m) > 0
    return select(region, ~floating)


def _around_keypoints(cloud: PointCloud, keypoints: Points, voxel_m: float) -> PointCloud:
    """The pieces of the merged cloud that keypoints lie on, and other large ones; small ones are dropped."""
    tree = cKDTree(cloud.points)
    pairs = tree.query_pairs(3 * voxel_m, output_type="ndarray").astype(np.int64)
    piece = components(len(cloud.points), pairs)
    size = np.bincount(piece)
    seeds = np.concatenate(tree.query_ball_point(keypoints, NEAR_M)).astype(int)
    seeded = np.bincount(piece[seeds], minlength=len(size)) > 0
    kept: Bool[np.ndarray, " n"] = ((seeded & (size > 0.02 * len(piece))) | (size > 0.2 * len(piece)))[piece]
    return select(cloud, kept)


def _contact_points(
    cloud: PointCloud, surroundings: Mapping[str, Surroundings], *, reach_m: float = 0.012
) -> Float64[np.ndarray, "_ 3"]:
    """Points where the object touches its support: its lowest points, projected onto the plane below."""
    contact = [np.empty((0, 3))]
    for around in surroundings.values():
        for plane in around.planes:
            height = plane.height_m(cloud.points)
            low = (height > -0.002) & (height < reach_m)
            contact.append(cloud.points[low] - height[low, None] * plane.normal)
    return np.concatenate(contact)
