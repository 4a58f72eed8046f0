"""Cast rays at triangles: depth images, silhouettes, visibility. No other module casts rays.

Directions have z = 1 in the camera frame, so the distance t along them is the depth in metres; a rigid
transform of origin and direction does not change t, which is why rays are moved to the mesh and the
acceleration structure is built once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64

from rpl_data.geometry import NEAREST_M, Pixels, Points, Transform, inside_image, invert, project, rays
from rpl_data.types import DataError, Intrinsics, Mesh


@dataclass(frozen=True)
class Hits:
    """First hits of rays on the meshes.

    Attributes:
        t: distance, in lengths of the direction; inf = the ray missed.
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


@dataclass(frozen=True)
class Closest:
    """Points of the meshes' surface, and the unit normals of the triangles they lie on."""

    points: Points
    normals: Points


class RayScene:
    """Meshes in one common frame, indexed for ray casting."""

    def __init__(self, meshes: Sequence[Mesh], *, threads: int = 0) -> None:
        """Build the index.

        Args:
            threads: number of cores that a call may use; 0 = all. Use 1 when frames run in parallel.

        Raises:
            DataError: there are no triangles.
        """
        import open3d as o3d

        if not sum(len(mesh.triangles) for mesh in meshes):
            raise DataError("a mesh without triangles cannot be rendered; run the segment stage again")
        self._tensor = o3d.core.Tensor
        self._threads = threads
        self._scene = o3d.t.geometry.RaycastingScene()
        for mesh in meshes:
            self._scene.add_triangles(
                o3d.core.Tensor(np.ascontiguousarray(mesh.vertices, dtype=np.float32)),
                o3d.core.Tensor(np.ascontiguousarray(mesh.triangles, dtype=np.uint32)),
            )

    def cast(self, origin_directions: Float32[np.ndarray, "n 6"]) -> Hits:
        """Find the first hit of each ray (ox, oy, oz, dx, dy, dz), in the meshes' frame."""
        answer = self._scene.cast_rays(self._as_tensor(origin_directions), nthreads=self._threads)
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
        """Distance of the first hit only; inf = the ray missed."""
        answer = self._scene.cast_rays(self._as_tensor(origin_directions), nthreads=self._threads)
        t: Float32[np.ndarray, " n"] = answer["t_hit"].numpy()
        return t

    def occluded(
        self, origin_directions: Float32[np.ndarray, "n 6"], *, far: float
    ) -> Bool[np.ndarray, " n"]:
        """Which rays hit something before the distance `far` (in lengths of the direction)."""
        blocked: Bool[np.ndarray, " n"] = self._scene.test_occlusions(
            self._as_tensor(origin_directions), tnear=0.0, tfar=far, nthreads=self._threads
        ).numpy()
        return blocked

    def closest(self, points: Points) -> Closest:
        """Find the point of the meshes nearest to each point, in the meshes' frame."""
        answer = self._scene.compute_closest_points(
            self._as_tensor(points.astype(np.float32)), nthreads=self._threads
        )
        return Closest(
            points=answer["points"].numpy().astype(np.float64),
            normals=answer["primitive_normals"].numpy().astype(np.float64),
        )

    def _as_tensor(self, rows: Float32[np.ndarray, "n _"]) -> Any:
        """Convert rays or points for Open3D, without a copy if they are float32 already."""
        return self._tensor.from_numpy(np.ascontiguousarray(rows, dtype=np.float32))


def pixel_rays(
    intrinsics: Intrinsics, *, left_px: int, top_px: int, width: int, height: int
) -> Float64[np.ndarray, "h w 3"]:
    """Directions (z = 1) through a rectangle's pixel centres, lens distortion removed; camera frame."""
    u, v = np.meshgrid(np.arange(left_px, left_px + width), np.arange(top_px, top_px + height))
    uv = np.column_stack([u.ravel(), v.ravel()]).astype(float)
    return rays(intrinsics, uv).reshape(height, width, 3)


def rays_in_object(
    directions_camera: Float[np.ndarray, "*shape 3"], camera_from_object: Transform
) -> Float32[np.ndarray, "n 6"]:
    """Rays from the camera centre in the object frame, in the layout of `RayScene.cast`."""
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
    """Render the depth of the meshes in a rectangle of the image, metres; 0 = nothing there."""
    directions = pixel_rays(intrinsics, left_px=left_px, top_px=top_px, width=width, height=height)
    return depth_along_m(rays, directions, camera_from_object)


def depth_along_m(
    rays: RayScene, directions_camera: Float[np.ndarray, "h w 3"], camera_from_object: Transform
) -> Float32[np.ndarray, "h w"]:
    """Render depth along given directions, those of `pixel_rays`, metres; 0 = nothing there."""
    t = rays.cast_t(rays_in_object(directions_camera, camera_from_object))
    depth_m: Float32[np.ndarray, "h w"] = np.where(np.isfinite(t), t, np.float32(0))
    return depth_m.reshape(directions_camera.shape[:2])


@dataclass(frozen=True)
class PixelTable:
    """Directions of all pixels of a camera, computed once: undistorting a lens costs more than casting.

    Attributes:
        intrinsics: the camera.
        directions: directions of the rays, z = 1, camera frame.
        x_range, y_range: lowest and highest x of every column's directions, y of every row's.
    """

    intrinsics: Intrinsics
    directions: Float32[np.ndarray, "height width 3"]
    x_range: Float64[np.ndarray, "2 width"]
    y_range: Float64[np.ndarray, "2 height"]

    @staticmethod
    def of(intrinsics: Intrinsics) -> PixelTable:
        """Make the table of a camera; 12 bytes per pixel."""
        directions = pixel_rays(
            intrinsics, left_px=0, top_px=0, width=intrinsics.width, height=intrinsics.height
        )
        x, y = directions[..., 0], directions[..., 1]
        return PixelTable(
            intrinsics,
            directions.astype(np.float32),
            np.array([x.min(axis=0), x.max(axis=0)]),
            np.array([y.min(axis=1), y.max(axis=1)]),
        )

    def window(self, points_camera: Points) -> tuple[slice, slice] | None:
        """Rows and columns that contain the convex hull of the points; None when it is out of view.

        Directions are compared, not pixels, so that no lens bends an edge of the hull out of the window
        or folds a far point into it. A hull that reaches behind the camera gets the whole image.
        """
        ahead = points_camera[:, 2] > NEAREST_M
        if not ahead.any():
            return None
        low, high = np.full(2, -np.inf), np.full(2, np.inf)
        if ahead.all():
            x, y = points_camera[:, 0] / points_camera[:, 2], points_camera[:, 1] / points_camera[:, 2]
            low, high = np.array([x.min(), y.min()]), np.array([x.max(), y.max()])
        columns = np.flatnonzero((self.x_range[1] >= low[0]) & (self.x_range[0] <= high[0]))
        rows = np.flatnonzero((self.y_range[1] >= low[1]) & (self.y_range[0] <= high[1]))
        if not len(columns) or not len(rows):
            return None
        return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)

    def project(self, points_camera: Points) -> Pixels:
        """Project to pixels; NaN behind the camera and where a lens polynomial folds far points into view."""
        uv = project(self.intrinsics, points_camera)
        if self.intrinsics.distortion:
            inside = np.flatnonzero(inside_image(self.intrinsics, uv))
            column, row = np.rint(uv[inside]).astype(int).T
            xy = points_camera[inside, :2] / points_camera[inside, 2:]
            five_pixels = 5 / min(self.intrinsics.fx, self.intrinsics.fy)
            apart = np.abs(self.directions[row, column, :2] - xy).max(axis=1, initial=0)
            uv[inside[apart > five_pixels]] = np.nan
        return uv
