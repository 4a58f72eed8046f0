"""How projections answer to small motions, to first order; lens distortion is ignored.

Distortion changes the derivatives by a few per cent at most.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import Points, Transform, transform
from rpl_data.types import Intrinsics


def projection_by_point(intrinsics: Intrinsics, points_camera: Points) -> Float64[np.ndarray, "n 2 3"]:
    """Derivative of each projection, in pixels, by its point in the camera frame.

    Infinite or NaN for points in the camera's plane and for points that are NaN.
    """
    x, y, z = points_camera.T
    derivative: Float64[np.ndarray, "n 2 3"] = np.zeros((len(points_camera), 2, 3))
    with np.errstate(divide="ignore", invalid="ignore"):
        derivative[:, 0, 0], derivative[:, 0, 2] = intrinsics.fx / z, -intrinsics.fx * x / z**2
        derivative[:, 1, 1], derivative[:, 1, 2] = intrinsics.fy / z, -intrinsics.fy * y / z**2
    return derivative


def projected_variance(
    intrinsics: Intrinsics,
    camera_from_frame: Transform,
    points: Points,
    covariance: Float64[np.ndarray, "n 3 3"],
) -> Float64[np.ndarray, " n"]:
    """Variance of each projection per axis, in squared pixels: the mean of u and v.

    Args:
        points, covariance: in any frame, and that of the points along its axes.
    """
    by_point = (
        projection_by_point(intrinsics, transform(camera_from_frame, points)) @ camera_from_frame[:3, :3]
    )
    with np.errstate(invalid="ignore"):
        variance: Float64[np.ndarray, " n"] = np.einsum("kij,kjl,kil->k", by_point, covariance, by_point)
    return variance / 2
