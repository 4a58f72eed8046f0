"""Velocity of a static scene's image before a moving camera."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Float64

from rpl_data.geometry import Transform, invert, rays
from rpl_data.types import DepthImage, Intrinsics

Twist = Float64[np.ndarray, "6"]
"""Velocity of a camera in its own frame: metres per second, then radians per second."""


def twist(a_from_before: Transform, a_from_after: Transform, span_s: float) -> Twist:
    """Mean velocity from one pose to another, `span_s` later; the rotation between them is small."""
    from scipy.spatial.transform import Rotation

    before_from_after = invert(a_from_before) @ a_from_after
    turn_rad = Rotation.from_matrix(before_from_after[:3, :3]).as_rotvec()
    return np.concatenate([before_from_after[:3, 3], turn_rad]) / span_s


def flow_px_s(
    intrinsics: Intrinsics,
    uv_px: Float64[np.ndarray, "n 2"],
    depth_m: Float[np.ndarray, " n"],
    camera: Twist,
) -> Float64[np.ndarray, "n 2"]:
    """Velocity of the scene's points in the image, pixels per second (Longuet-Higgins & Prazdny, 1980).

    Args:
        depth_m: depth of the points; 0 = infinitely far.
    """
    ray = rays(intrinsics, uv_px)
    nearness = np.divide(1, depth_m, out=np.zeros(len(depth_m)), where=depth_m > 0)
    velocity = -nearness[:, None] * camera[:3] - np.cross(camera[3:], ray)  # of the point, over its depth
    on_plane = velocity[:, :2] - ray[:, :2] * velocity[:, 2:]
    flow: Float64[np.ndarray, "n 2"] = on_plane * [intrinsics.fx, intrinsics.fy]
    return flow


def image_flow_px_s(
    intrinsics: Intrinsics, depth_m: DepthImage, camera: Twist
) -> Float32[np.ndarray, "height width 2"]:
    """Velocity at every pixel."""
    v, u = np.mgrid[: depth_m.shape[0], : depth_m.shape[1]]
    uv_px = np.column_stack([u.ravel(), v.ravel()]).astype(float)
    flow = flow_px_s(intrinsics, uv_px, depth_m.ravel(), camera)
    return flow.reshape(*depth_m.shape, 2).astype(np.float32)


def row_delay_s(
    v_px: Float[np.ndarray, "*shape"], height: int, readout_s: float
) -> Float[np.ndarray, "*shape"]:
    """Time by which a row is exposed later than the middle row; negative above it."""
    delay: Float[np.ndarray, "*shape"] = readout_s * (v_px / (height - 1) - 0.5)
    return delay
