"""The dense model as the paper makes it: regions grown from the keypoints in every scene, put together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool
from scipy.spatial import cKDTree

from rpl_data.geometry import Points, invert, transform
from rpl_data.meshes import joined, joined_meshes, oriented_points, select, thinned
from rpl_data.segment.completion import open_edges
from rpl_data.segment.free_space import DepthView, free_share
from rpl_data.segment.refusals import refuse_without_surface
from rpl_data.segment.region_growing import CropBox, inside
from rpl_data.segment.segment import DenseModel
from rpl_data.segment.smooth_regions import grow_from_seeds
from rpl_data.types import Mesh, PointCloud, Solution

AROUND_M = 0.2
"""Surfaces are cut to a cube that reaches so far from the middle of the keypoints, as by the authors."""


def join_smooth_regions(
    surfaces: Mapping[str, Mesh],
    solution: Solution,
    *,
    voxel_m: float = 0.003,
    crop_m: CropBox | None = None,
    depth_views: Sequence[DepthView] = (),
) -> DenseModel:
    """Make the dense model: in each scene's surface, what can be reached from the keypoints without a bend.

    It may have holes and pieces of the background, which the paper crops by hand (`crop_m`). Nothing is
    closed: the mesh is those triangles of the surfaces that lie in the regions.

    Args:
        surfaces, voxel_m, crop_m, depth_views: as in `segment_object`.

    Raises:
        DataError: no surface is found at the keypoints.
    """
    keypoints = solution.model.points_object[solution.model.known]
    pieces = {
        scene: _piece(mesh, solution.scene_from_object[scene], keypoints, voxel_m, crop_m)
        for scene, mesh in surfaces.items()
        if scene in solution.scene_from_object
    }
    found = [piece for piece in pieces.values() if len(piece[0].points) and len(piece[1].triangles)]
    if not found:
        refuse_without_surface(surfaces, solution, crop_m)
    mesh = joined_meshes([mesh for _, mesh in found])
    return DenseModel(
        mesh=mesh,
        cloud=thinned(joined([cloud for cloud, _ in found]), voxel_m=voxel_m),
        seen=np.ones(len(mesh.triangles), bool),
        open_edges=open_edges(mesh),
        free_share=free_share(mesh, depth_views) if depth_views else float("nan"),
        warnings=tuple(
            f"scene {scene} has no surface at the keypoints"
            for scene in surfaces
            if scene not in pieces or not len(pieces[scene][0].points)
        ),
    )


def _piece(
    mesh: Mesh, scene_from_object: np.ndarray, keypoints: Points, voxel_m: float, crop_m: CropBox | None
) -> tuple[PointCloud, Mesh]:
    """The region of one scene in the object frame, as points and as the triangles between them."""
    moved = Mesh(transform(invert(scene_from_object), mesh.vertices), mesh.triangles, mesh.colors)
    centre = keypoints.mean(axis=0)
    cloud = oriented_points(moved)
    cloud = select(cloud, (np.abs(cloud.points - centre) < AROUND_M).all(axis=1))
    if not len(cloud.points):
        return cloud, Mesh(moved.vertices, moved.triangles[:0])
    cloud = thinned(cloud, voxel_m=voxel_m)
    kept = grow_from_seeds(cloud.points, keypoints)
    if crop_m is not None:
        kept &= inside(cloud.points, crop_m)
    return select(cloud, kept), _triangles_at(moved, cloud.points, kept, voxel_m)


def _triangles_at(mesh: Mesh, points: Points, kept: Bool[np.ndarray, " n"], voxel_m: float) -> Mesh:
    """The triangles whose corners all belong to kept points, each corner to the nearest point."""
    distance, nearest = cKDTree(points).query(mesh.vertices)
    kept_vertices = kept[nearest] & (distance < 2 * voxel_m)
    triangles = mesh.triangles[kept_vertices[mesh.triangles].all(axis=1)]
    used, corners = np.unique(triangles, return_inverse=True)
    colors = None if mesh.colors is None else mesh.colors[used]
    return Mesh(mesh.vertices[used], corners.reshape(-1, 3).astype(np.int64), colors)
