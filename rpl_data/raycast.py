"""Rays against triangles: depth images, silhouettes, visibility. The one place that casts rays.

Directions have z = 1 in the camera frame, so the distance t along them is the depth in metres; a rigid
transform of origin and direction leaves t as it is, which is why rays are moved to the mesh and the
acceleration structure is built once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from rpl_data.geometry import Transform, invert, rays
from rpl_data.types import DataError, Intrinsics, Mesh


@dataclass(frozen=True)
class Hits:
    """Where rays met the meshes first.

    Attributes:
        t: distance in lengths of the direction; inf = the ray missed.
        mesh_id: number of the mesh in the order given; -1 = the ray missed.
        triangle_id: row of `Mesh.triangles`; -1 = the ray missed.
        uv: barycentric coordinates in the triangle.
        normals: unit normals of the triangles, in the meshes' frame.
    """

    t: Float32[np.ndarray, " n"]
    mesh_id: Int64[np.ndarray, " n"]
    triangle_id: Int64[np.ndarray, " n"]
    uv: Float32[np.ndarray, "n 2"]
    normals: Float32[np.ndarray, "n 3"]


class RayScene:
    """Meshes of one common frame, indexed for rays."""

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        """Build the index.

        Raises:
            DataError: there is no triangle at all.
        """
        import open3d as o3d

        if not sum(len(mesh.triangles) for mesh in meshes):
            raise DataError("a mesh without triangles cannot be seen; run the segment stage again")
        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene()
        for mesh in meshes:
            self._scene.add_triangles(
                o3d.core.Tensor(np.ascontiguousarray(mesh.vertices, dtype=np.float32)),
                o3d.core.Tensor(np.ascontiguousarray(mesh.triangles, dtype=np.uint32)),
            )

    def cast(self, origin_directions: Float32[np.ndarray, "n 6"]) -> Hits:
        """The first hit of each ray (ox, oy, oz, dx, dy, dz) in the meshes' frame."""
        answer = self._scene.cast_rays(
            self._tensor(np.ascontiguousarray(origin_directions, dtype=np.float32))
        )
        t = answer["t_hit"].numpy()
        hit = np.isfinite(t)
        return Hits(
            t=t,
            mesh_id=np.where(hit, answer["geometry_ids"].numpy().astype(np.int64), -1),
            triangle_id=np.where(hit, answer["primitive_ids"].numpy().astype(np.int64), -1),
            uv=answer["primitive_uvs"].numpy(),
            normals=answer["primitive_normals"].numpy(),
        )

    def cast_t(self, origin_directions: Float32[np.ndarray, "n 6"]) -> Float32[np.ndarray, " n"]:
        """Distance of the first hit alone, inf = miss; `cast` without the rest."""
        answer = self._scene.cast_rays(
            self._tensor(np.ascontiguousarray(origin_directions, dtype=np.float32))
        )
        t: Float32[np.ndarray, " n"] = answer["t_hit"].numpy()
        return t

    def occluded(
        self, origin_directions: Float32[np.ndarray, "n 6"], *, far: float
    ) -> Bool[np.ndarray, " n"]:
        """Which rays meet something before the distance `far` (in lengths of the direction)."""
        tensor = self._tensor(np.ascontiguousarray(origin_directions, dtype=np.float32))
        blocked: Bool[np.ndarray, " n"] = self._scene.test_occlusions(tensor, tnear=0.0, tfar=far).numpy()
        return blocked


def pixel_rays(
    intrinsics: Intrinsics, *, left_px: int, top_px: int, width: int, height: int
) -> Float64[np.ndarray, "h w 3"]:
    """Directions with z = 1 through the pixel centres of a rectangle, lens distortion removed; camera frame."""
    u, v = np.meshgrid(np.arange(left_px, left_px + width), np.arange(top_px, top_px + height))
    uv = np.column_stack([u.ravel(), v.ravel()]).astype(float)
    return rays(intrinsics, uv).reshape(height, width, 3)


def rays_in_object(
    directions_camera: Float64[np.ndarray, "*shape 3"], camera_from_object: Transform
) -> Float32[np.ndarray, "n 6"]:
    """Rays from the camera centre, as `RayScene` wants them, in the object frame."""
    object_from_camera = invert(camera_from_object).astype(np.float32)
    directions = directions_camera.reshape(-1, 3).astype(np.float32, copy=False)
    moved = np.empty((len(directions), 6), dtype=np.float32)
    moved[:, :3] = object_from_camera[:3, 3]
    np.matmul(directions, object_from_camera[:3, :3].T, out=moved[:, 3:])
    return moved


def render_depth_m(
    rays: RayScene,
    intrinsics: Intrinsics,
    camera_from_object: Transform,
    *,
    left_px: int,
    top_px: int,
    width: int,
    height: int,
) -> Float32[np.ndarray, "h w"]:
    """Depth in metres of the meshes in a rectangle of the image; 0 = nothing there."""
    directions = pixel_rays(intrinsics, left_px=left_px, top_px=top_px, width=width, height=height)
    return depth_along_m(rays, directions, camera_from_object)


def depth_along_m(
    rays: RayScene, directions_camera: Float64[np.ndarray, "h w 3"], camera_from_object: Transform
) -> Float32[np.ndarray, "h w"]:
    """`render_depth_m` with the directions of `pixel_rays` at hand; 0 = nothing there."""
    t = rays.cast_t(rays_in_object(directions_camera, camera_from_object))
    depth_m: Float32[np.ndarray, "h w"] = np.where(np.isfinite(t), t, np.float32(0))
    return depth_m.reshape(directions_camera.shape[:2])
