"""A grasp frame from two clicks in one frame: the grasp point, and a point that its x axis points to.

The frame is right-handed: z is the outward normal of the surface at the first click, x lies in the
surface and points toward the second click, y = z × x. (RapidPoseLabels leaves the sign of the normal
free and writes the transposed rotation.)
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import Transform, back_project, rays, rigid
from rpl_data.types import DataError, DepthImage, Intrinsics

REACH_M = 0.012
"""The surface within this distance of the click is taken as a plane."""
FEWEST_PIXELS = 12
"""Depth pixels that the plane needs at least."""

Vector = Float64[np.ndarray, "3"]


def grasp_frame(
    intrinsics: Intrinsics,
    depth_m: DepthImage,
    uv_px: tuple[float, float],
    toward_px: tuple[float, float],
) -> Transform:
    """Compute `camera_from_grasp` from two clicks.

    Args:
        uv_px: the click on the grasp point.
        toward_px: the click that the x axis points to.

    Raises:
        DataError: there is no depth at the first click, or the second one gives no direction.
    """
    near = _surface_around(intrinsics, depth_m, uv_px)
    normal = _outward_normal(near)
    ray, toward = rays(intrinsics, np.array([uv_px, toward_px], dtype=float))
    origin = _on_plane(ray, near.mean(axis=0), normal)
    x = _on_plane(toward, origin, normal) - origin
    if np.linalg.norm(x) < 1e-4:
        raise DataError("the two clicks of the grasp are on one spot; click the second one farther away")
    x /= np.linalg.norm(x)
    return rigid(np.column_stack([x, np.cross(normal, x), normal]), origin)


def _surface_around(
    intrinsics: Intrinsics, depth_m: DepthImage, uv_px: tuple[float, float]
) -> Float64[np.ndarray, "n 3"]:
    """Points of the surface around the click, in the camera frame."""
    u, v = (round(x) for x in uv_px)
    core = depth_m[max(0, v - 2) : v + 3, max(0, u - 2) : u + 3]
    measured = core[core > 0]
    if not len(measured):
        raise DataError("there is no depth where the grasp was clicked; click on a place that has depth")
    centre_m = float(np.median(measured))
    reach_px = int(np.ceil(REACH_M * intrinsics.fx / centre_m))
    rows = np.arange(max(0, v - reach_px), min(depth_m.shape[0], v + reach_px + 1))
    columns = np.arange(max(0, u - reach_px), min(depth_m.shape[1], u + reach_px + 1))
    vv, uu = (grid.ravel() for grid in np.meshgrid(rows, columns, indexing="ij"))
    z = depth_m[vv, uu].astype(float)
    points = back_project(intrinsics, np.column_stack([uu, vv]).astype(float), z)
    middle = back_project(intrinsics, np.array([[u, v]], dtype=float), np.array([centre_m]))
    near: Float64[np.ndarray, "n 3"] = points[(z > 0) & (np.linalg.norm(points - middle, axis=1) < REACH_M)]
    if len(near) < FEWEST_PIXELS:
        raise DataError(
            f"only {len(near)} depth pixels lie on the surface where the grasp was clicked, "
            f"{FEWEST_PIXELS} are needed; click farther from the edge, or in a nearer frame"
        )
    return near


def _outward_normal(points: Float64[np.ndarray, "n 3"]) -> Vector:
    """The direction in which the points spread least, pointing to the side of the camera."""
    centred = points - points.mean(axis=0)
    normal: Vector = np.linalg.svd(centred, full_matrices=False)[2][2]
    return -normal if normal @ points.mean(axis=0) > 0 else normal


def _on_plane(ray: Vector, point: Vector, normal: Vector) -> Vector:
    """Where a ray from the camera meets the plane through a point."""
    along = float(ray @ normal)
    if abs(along) < 1e-6 or (point @ normal) / along <= 0:
        raise DataError("the grasp's second click does not meet the plane of the first; click nearer to it")
    met: Vector = ray * ((point @ normal) / along)
    return met
