"""Refine poses by Levenberg-Marquardt: reprojection weighted by covariance, and depth; robust or not.

The work is done in compiled code (`minimize`, `reproject`), which is imported when it is first needed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import NEAREST_M, Transform, transform
from rpl_data.pose.correspondences import Correspondences

Poses = Float64[np.ndarray, "m 4 4"]
Arrays = tuple[np.ndarray, ...]
"""Of `Correspondences`, as compiled code takes them: always of one kind, so that it is compiled once."""


def refined(pose: Transform, given: Correspondences, *, robust: bool, iterations: int = 15) -> Transform:
    """Refine ``camera_from_object`` to a local minimum of the cost.

    Args:
        pose: initial pose.
        given: the observed keypoints.
        robust: use Geman-McClure's cost instead of squares, so that a wrong keypoint has little effect.
        iterations: largest number; refinement ends after a step below `SMALLEST_STEP` of `minimize`.

    Raises:
        LinAlgError: the keypoints leave a direction of the pose free.
    """
    from rpl_data.pose.minimize import minimize

    found = np.array(pose, dtype=float)
    if not minimize(found, _arrays(given), robust, iterations):
        raise np.linalg.LinAlgError("the keypoints leave a direction of the pose free")
    return found


def nearest_to_depth(pose: Transform, given: Correspondences) -> Transform:
    """Move a pose along its line of sight to the distance that the measured depths agree with best.

    A distance from keypoints alone may be wrong by more than the robust cost feels, and some depths are those
    of a surface in front of the keypoint or behind it. So each measured depth proposes a distance, and the
    robust cost of all residuals decides between these and the distance as it is.
    """
    measured = np.isfinite(given.depth_m)
    z = transform(pose, given.points_object)[:, 2]
    farther = given.depth_m[measured] / np.maximum(z[measured], NEAREST_M)
    tried = np.repeat(pose[None], 1 + len(farther), axis=0)
    tried[1:, :3, 3] *= farther[:, None]
    costs = [_normal_equations(each, given, robust=True)[0] for each in tried]
    nearest: Transform = tried[int(np.argmin(costs))]
    return nearest


def covariance_of(pose: Transform, given: Correspondences) -> Float64[np.ndarray, "6 6"]:
    """Covariance of a small rotation about the object's origin and a translation, from the Jacobian.

    Radians and metres, in this order, along the camera's axes.

    Raises:
        LinAlgError: the keypoints leave a direction of the pose free.
    """
    inverse: Float64[np.ndarray, "6 6"] = np.linalg.inv(_normal_equations(pose, given, robust=False)[1])
    return inverse


def reprojection_sigmas(camera_from_object: Poses, given: Correspondences) -> Float64[np.ndarray, "m n"]:
    """Reprojection error of each keypoint in standard deviations; inf behind the camera."""
    from rpl_data.pose.reproject import write_sigmas

    sigmas = np.empty((len(camera_from_object), len(given)))
    write_sigmas(np.ascontiguousarray(camera_from_object), _arrays(given), sigmas)
    return sigmas


def robust_cost(sigmas: Float64[np.ndarray, "m n"]) -> Float64[np.ndarray, " m"]:
    """Geman-McClure's cost, summed over each row."""
    from rpl_data.pose.reproject import write_robust_costs

    costs = np.empty(len(sigmas))
    write_robust_costs(np.ascontiguousarray(sigmas), costs)
    return costs


def with_own_depth(pose: Transform, given: Correspondences, *, largest_sigmas: float) -> Correspondences:
    """Forget the depths that are not the keypoints' own: of what hides them, or of what is behind them."""
    z = transform(pose, given.points_object)[:, 2]
    own = np.abs(z - given.depth_m) < largest_sigmas * given.depth_sigma_m  # False for NaN
    return replace(given, depth_m=np.where(own, given.depth_m, np.nan))


def _normal_equations(
    pose: Transform, given: Correspondences, *, robust: bool
) -> tuple[float, Float64[np.ndarray, "6 6"]]:
    """Cost of a pose, and ``J^T W J`` there."""
    from rpl_data.pose.minimize import write_normal_equations

    normal, slope = np.empty((6, 6)), np.empty(6)
    cost = write_normal_equations(np.array(pose, dtype=float), _arrays(given), robust, normal, slope)
    return cost, normal


def _arrays(given: Correspondences) -> Arrays:
    return (
        np.ascontiguousarray(given.points_object),
        np.ascontiguousarray(given.positions_px),
        given.focal_px,
        np.ascontiguousarray(given.whitening),
        given.depth_m,
        given.depth_sigma_m,
    )
