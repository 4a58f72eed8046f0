"""Points of an object seen from some sides -> a closed mesh that has the object's outline."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import ConvexHull, cKDTree

from rpl_data.geometry import Points
from rpl_data.meshes import joined
from rpl_data.types import DataError, Mesh, PointCloud


def closed_mesh(cloud: PointCloud, anchors: Points, *, voxel_m: float) -> Mesh:
    """A watertight mesh through the cloud; sides nobody saw are closed by the convex hull.

    The convex hull of the cloud and the anchors is added as points wherever no surface was seen
    below it (the bottom, a side no camera went to), so that Poisson reconstruction has no hole to
    bulge out of; the result is then clamped to the hull.

    Args:
        anchors: points known to be on the object but not in the cloud: keypoints on corners, the
            foot of the object on what it stands on.

    Returns:
        A mesh in the cloud's frame, coloured by the nearest point of the cloud when that has colours.

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
    unseen = _unseen_hull(hull, cloud, voxel_m)
    mesh = _poisson(joined([PointCloud(cloud.points, cloud.normals), unseen]), voxel_m)
    return _colored(Mesh(_clamped(mesh.vertices, hull), mesh.triangles), cloud)


def _unseen_hull(hull: Any, cloud: PointCloud, voxel_m: float) -> PointCloud:
    """Points on the convex hull, away from the cloud, under which no surface was seen."""
    samples = _hull_samples(hull, spacing_m=voxel_m)
    tree = cKDTree(cloud.points)
    distance = tree.query(samples.points)[0]
    _, nearest = tree.query(samples.points)
    offset = samples.points - cloud.points[nearest]
    floating = (offset * cloud.normals[nearest]).sum(axis=1) > 0.5 * distance
    chosen: Bool[np.ndarray, " n"] = (distance > 2 * voxel_m) & ~floating
    return PointCloud(samples.points[chosen], samples.normals[chosen])


def _hull_samples(hull: Any, *, spacing_m: float) -> PointCloud:
    """Points all over the convex hull with outward normals."""
    generator = np.random.default_rng(0)
    corners = hull.points[hull.simplices]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    counts = generator.poisson(area / spacing_m**2)
    facet = np.repeat(np.arange(len(corners)), counts)
    weights = generator.dirichlet(np.ones(3), len(facet))
    points = np.einsum("nc,ncx->nx", weights, corners[facet])
    return PointCloud(points, hull.equations[facet, :3])


def _poisson(cloud: PointCloud, voxel_m: float) -> Mesh:
    """Screened Poisson reconstruction (Kazhdan and Hoppe, TOG 2013), its largest piece."""
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
    """Points outside the convex hull moved onto it (projection onto its facets in turn)."""
    moved = points.copy()
    for _ in range(passes):
        excess: Float64[np.ndarray, "n f"] = moved @ hull.equations[:, :3].T + hull.equations[:, 3]
        worst = excess.argmax(axis=1)
        outside = excess[np.arange(len(moved)), worst] > 1e-6
        if not outside.any():
            break
        moved[outside] -= excess[outside, worst[outside], None] * hull.equations[worst[outside], :3]
    return moved


def _colored(mesh: Mesh, cloud: PointCloud) -> Mesh:
    if cloud.colors is None:
        return mesh
    return Mesh(mesh.vertices, mesh.triangles, cloud.colors[cKDTree(cloud.points).query(mesh.vertices)[1]])
