"""Close the surface of an object seen from some sides to a watertight mesh with the object's outline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import ConvexHull, cKDTree

from rpl_data.geometry import Points
from rpl_data.meshes import joined, select, vertex_normals
from rpl_data.segment.free_space import DepthView, unseen_border
from rpl_data.types import DataError, Mesh, PointCloud

BLENDED = 8
"""Points of the cloud that a vertex takes its colour from."""


@dataclass(frozen=True)
class ClosedMesh:
    """A surface around the whole object.

    Attributes:
        seen: for each triangle, whether it lies on surface that a scene saw; the others close unseen sides.
        open_edges: edges without exactly two triangles; 0 = the mesh is watertight. The mesh may touch
            or cross itself where it was projected onto the convex hull.
    """

    mesh: Mesh
    seen: Bool[np.ndarray, " m"]
    open_edges: int


def closed_mesh(
    cloud: PointCloud, anchors: Points, *, voxel_m: float, views: Sequence[DepthView] = ()
) -> ClosedMesh:
    """Fit a mesh to the cloud, and close unseen sides as far out as the depth images allow.

    Where no surface was seen (the bottom, a side no camera went to), the object may fill all space within
    the convex hull of the cloud and the anchors that no depth image saw through. The border of that space is
    added as points, so that Poisson reconstruction has no hole to bulge out of; vertices outside the hull
    are then moved onto it.

    Args:
        anchors: points on the object that the cloud lacks: keypoints on corners, and the points where the
            object touches its support.
        views: depth images; without them unseen sides are closed by the convex hull.

    Returns:
        A mesh in the cloud's frame, coloured by the cloud's points around each vertex, if they have colours.

    Raises:
        DataError: fewer than four points, or all in one plane.
    """
    every = np.concatenate([cloud.points, anchors])
    if len(every) < 4 or np.linalg.matrix_rank(every - every.mean(axis=0), tol=1e-3) < 3:
        raise DataError(
            f"the dense model has {len(every)} points in one plane; expected the surface of a solid "
            "object; record the object from more sides or click more keypoints"
        )
    hull = ConvexHull(every)
    unseen = _away_from(unseen_border(hull.equations, hull.points[hull.vertices], views), cloud, voxel_m)
    mesh = _poisson(joined([PointCloud(cloud.points, cloud.normals), unseen]), voxel_m)
    mesh = _colored(Mesh(_clamped(mesh.vertices, hull), mesh.triangles), cloud, voxel_m)
    return ClosedMesh(mesh, _seen(mesh, cloud, voxel_m), open_edges(mesh))


def mesh_of_border(border: PointCloud, *, voxel_m: float) -> ClosedMesh:
    """Fit a mesh to the border of the space that an object may fill, of which no camera saw any."""
    mesh = _poisson(border, voxel_m)
    return ClosedMesh(mesh, np.zeros(len(mesh.triangles), bool), open_edges(mesh))


def open_edges(mesh: Mesh) -> int:
    """Number of edges that do not have exactly two triangles."""
    sides = mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, count = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    return int((count != 2).sum())


def _seen(mesh: Mesh, cloud: PointCloud, voxel_m: float) -> Bool[np.ndarray, " m"]:
    """Triangles whose centre is near a seen point."""
    centres = mesh.vertices[mesh.triangles].mean(axis=1)
    near: Bool[np.ndarray, " m"] = cKDTree(cloud.points).query(centres)[0] < 2 * voxel_m
    return near


def _away_from(border: PointCloud, cloud: PointCloud, voxel_m: float) -> PointCloud:
    """The points of the border that are neither near the seen surface nor in front of it."""
    distance, nearest = cKDTree(cloud.points).query(border.points)
    offset = border.points - cloud.points[nearest]
    floating = (offset * cloud.normals[nearest]).sum(axis=1) > 0.5 * distance
    return select(border, (distance > 2.5 * voxel_m) & ~floating)


def _poisson(cloud: PointCloud, voxel_m: float) -> Mesh:
    """The largest piece of a screened Poisson reconstruction (Kazhdan and Hoppe, TOG 2013)."""
    import open3d as o3d

    legacy = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points))
    legacy.normals = o3d.utility.Vector3dVector(cloud.normals)
    extent_m = float(np.ptp(cloud.points, axis=0).max())
    depth = int(np.clip(np.ceil(np.log2(1.1 * extent_m / voxel_m)), 5, 8))
    # One thread: several make the result differ from run to run.
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        legacy, depth=depth, scale=1.1, linear_fit=True, n_threads=1
    )
    labels, counts, _ = mesh.cluster_connected_triangles()
    mesh.remove_triangles_by_mask(np.asarray(labels) != int(np.argmax(counts)))
    mesh.remove_unreferenced_vertices()
    return Mesh(np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int64))


def _clamped(points: Points, hull: Any, *, passes: int = 30) -> Points:
    """Move points outside the convex hull onto it, by repeated projection onto the most violated facet."""
    moved = points.copy()
    for _ in range(passes):
        excess: Float64[np.ndarray, "n f"] = moved @ hull.equations[:, :3].T + hull.equations[:, 3]
        worst = excess.argmax(axis=1)
        outside = excess[np.arange(len(moved)), worst] > 1e-6
        if not outside.any():
            break
        moved[outside] -= excess[outside, worst[outside], None] * hull.equations[worst[outside], :3]
    return moved


def _colored(mesh: Mesh, cloud: PointCloud, voxel_m: float) -> Mesh:
    """Colour each vertex by the points around it that face as it does, near ones most.

    Scenes differ in light and by a fraction of a voxel; the nearest point alone would speckle the print.
    """
    if cloud.colors is None:
        return mesh
    distance, nearest = cKDTree(cloud.points).query(mesh.vertices, k=min(BLENDED, len(cloud.points)))
    near = np.exp(-2 * (distance**2 - distance[:, :1] ** 2) / voxel_m**2)
    facing = np.einsum("nkc,nc->nk", cloud.normals[nearest], vertex_normals(mesh))
    weight = near * np.maximum(facing, 0.02)
    colors = (
        np.einsum("nk,nkc->nc", weight, cloud.colors[nearest].astype(float)) / weight.sum(axis=1)[:, None]
    )
    return Mesh(mesh.vertices, mesh.triangles, colors.round().astype(np.uint8))
