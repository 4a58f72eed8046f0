"""Refine poses by Levenberg-Marquardt: reprojection weighted by covariance, and depth; robust or not.

A step moves a pose by a rotation vector w and a translation d in the camera frame,
``x -> exp(w) R x + t + d``; several poses are refined at once. Arrays are (pose, axis, keypoint), so that
one matrix product moves all keypoints by all poses.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import NEAREST_M
from rpl_data.pose.algebra import small_rotations
from rpl_data.pose.correspondences import Correspondences

Poses = Float64[np.ndarray, "m 4 4"]

ROBUST_SCALE = 3.0
"""Residuals beyond this many standard deviations lose weight fastest (Geman-McClure)."""

SMALLEST_STEP = 1e-3
"""Radians and metres: a smaller step is still made, but is the last. Two pixels of noise leave an
uncertainty many times as large, and near the end steps shrink more than tenfold."""


def refined(
    camera_from_object: Poses, given: Correspondences, *, robust: bool, iterations: int = 15
) -> Poses:
    """Refine each pose to a local minimum of the cost.

    Args:
        camera_from_object: initial poses.
        given: the observed keypoints.
        robust: use Geman-McClure's cost instead of squares, so that a wrong keypoint has little effect.
        iterations: largest number; refinement ends after a step below `SMALLEST_STEP`.
    """
    poses = camera_from_object.copy()
    residuals, jacobian = _linearised(poses, given)
    costs, weights = _costs(residuals, robust)
    damping = np.full(len(poses), 1e-3)
    for _ in range(iterations):
        step = _step(residuals, jacobian, weights, damping)
        tried = _moved(poses, step)
        if np.abs(step).max() < SMALLEST_STEP:
            return tried
        tried_residuals, tried_jacobian = _linearised(tried, given)
        tried_costs, tried_weights = _costs(tried_residuals, robust)
        better = tried_costs < costs
        poses[better], costs[better] = tried[better], tried_costs[better]
        residuals[better], jacobian[better] = tried_residuals[better], tried_jacobian[better]
        weights[better] = tried_weights[better]
        damping = np.where(better, damping * 0.1, damping * 10)
    return poses


def nearest_to_depth(
    camera_from_object: Float64[np.ndarray, "4 4"], given: Correspondences
) -> Float64[np.ndarray, "4 4"]:
    """Move a pose along its line of sight to the distance that the measured depths agree with best.

    A distance from keypoints alone may be wrong by more than the robust cost feels, and some depths are those
    of a surface in front of the keypoint or behind it. So each measured depth proposes a distance, and the
    robust cost of all residuals decides between these and the distance as it is.
    """
    measured = np.isfinite(given.depth_m)
    z = _turned(camera_from_object[None], given)[2, 0] + camera_from_object[2, 3]
    farther = given.depth_m[measured] / np.maximum(z[measured], NEAREST_M)
    tried = np.repeat(camera_from_object[None], 1 + len(farther), axis=0)
    tried[1:, :3, 3] *= farther[:, None]
    costs, _ = _costs(_linearised(tried, given)[0], robust=True)
    nearest: Float64[np.ndarray, "4 4"] = tried[int(np.argmin(costs))]
    return nearest


def covariance_of(
    camera_from_object: Float64[np.ndarray, "4 4"], given: Correspondences
) -> Float64[np.ndarray, "6 6"]:
    """Covariance of (w, d) in the module's docstring, rad and metres, from the Jacobian."""
    _, jacobian = _linearised(camera_from_object[None], given)
    flat = jacobian.reshape(6, -1)
    inverse: Float64[np.ndarray, "6 6"] = np.linalg.inv(flat @ flat.T)
    return inverse


def reprojection_sigmas(camera_from_object: Poses, given: Correspondences) -> Float64[np.ndarray, "m n"]:
    """Reprojection error of each keypoint in standard deviations; inf behind the camera."""
    x, y, z = _turned(camera_from_object, given) + _shift(camera_from_object)
    ahead = z > NEAREST_M
    z = np.where(ahead, z, 1.0)
    u = x / z * given.focal_px[0] - given.positions_px[:, 0]
    v = y / z * given.focal_px[1] - given.positions_px[:, 1]
    white = given.whitening
    squares = (white[:, 0, 0] * u) ** 2 + (white[:, 1, 0] * u + white[:, 1, 1] * v) ** 2
    return np.where(ahead, np.sqrt(squares), np.inf)


def with_own_depth(
    camera_from_object: Float64[np.ndarray, "4 4"], given: Correspondences, *, largest_sigmas: float
) -> Correspondences:
    """Forget the depths that are not the keypoints' own: of what hides them, or of what is behind them."""
    z = _turned(camera_from_object[None], given)[2, 0] + camera_from_object[2, 3]
    own = np.abs(z - given.depth_m) < largest_sigmas * given.depth_sigma_m  # False for NaN
    return replace(given, depth_m=np.where(own, given.depth_m, np.nan))


def robust_cost(sigmas: Float64[np.ndarray, "m n"]) -> Float64[np.ndarray, " m"]:
    """Geman-McClure's cost, summed over each row."""
    squares = np.minimum(sigmas, 1e6) ** 2
    cost: Float64[np.ndarray, " m"] = (squares / (1 + squares / ROBUST_SCALE**2)).sum(axis=-1)
    return cost


def _turned(poses: Poses, given: Correspondences) -> Float64[np.ndarray, "3 m n"]:
    """Rotate the keypoints by the poses, without translation; x, y, z first."""
    rows = np.ascontiguousarray(poses[:, :3, :3].transpose(1, 0, 2)).reshape(-1, 3)
    turned: Float64[np.ndarray, "3 m n"] = (rows @ given.points_object.T).reshape(3, len(poses), -1)
    return turned


def _shift(poses: Poses) -> Float64[np.ndarray, "3 m 1"]:
    return poses[:, :3, 3].T[..., None]


def _linearised(
    poses: Poses, given: Correspondences
) -> tuple[Float64[np.ndarray, "m r n"], Float64[np.ndarray, "m 6 r n"]]:
    """Residuals of unit variance, and their derivatives with respect to (w, d).

    r is 2 (u, v), or 3 when the depth of any keypoint is known; without depth the third residual is 0. With
    a = R x, p = a + t and b = dr/dp: dr/dd = b and dr/dw = a x b.
    """
    a = ax, ay, az = _turned(poses, given)
    x, y, z = a + _shift(poses)
    z = np.maximum(z, NEAREST_M)  # a point behind the camera costs so much that the step is rejected
    measured = np.isfinite(given.depth_m)
    rows = 3 if measured.any() else 2
    off = np.zeros((len(poses), rows, len(given)))
    by = np.zeros((len(poses), 6, rows, len(given)))
    by_x, by_y = given.focal_px[0] / z, given.focal_px[1] / z
    u, v = by_x * x, by_y * y
    du, dv = -u / z, -v / z
    by[:, 0, 0], by[:, 1, 0], by[:, 2, 0] = ay * du, az * by_x - ax * du, -ay * by_x
    by[:, 3, 0], by[:, 5, 0] = by_x, du
    by[:, 0, 1], by[:, 1, 1], by[:, 2, 1] = ay * dv - az * by_y, -ax * dv, ax * by_y
    by[:, 4, 1], by[:, 5, 1] = by_y, dv
    off[:, 0], off[:, 1] = u - given.positions_px[:, 0], v - given.positions_px[:, 1]
    for array in (off, by):  # the whitening is lower triangular: v first, since u is still needed for it
        array[..., 1, :] *= given.whitening[:, 1, 1]
        array[..., 1, :] += given.whitening[:, 1, 0] * array[..., 0, :]
        array[..., 0, :] *= given.whitening[:, 0, 0]
    if rows == 3:
        sharpness = np.where(measured, 1 / given.depth_sigma_m, 0.0)
        off[:, 2] = np.where(measured, z - given.depth_m, 0.0) * sharpness
        by[:, 0, 2], by[:, 1, 2], by[:, 5, 2] = ay * sharpness, -ax * sharpness, sharpness
    return off, by


def _costs(
    residuals: Float64[np.ndarray, "m r n"], robust: bool
) -> tuple[Float64[np.ndarray, " m"], Float64[np.ndarray, "m r n"]]:
    """Cost of each pose and weight of each residual; u and v share a weight, depth has its own."""
    squares = residuals**2
    squares[:, 0] += squares[:, 1]
    squares[:, 1] = squares[:, 0]
    if not robust:
        return squares[:, 1:].sum(axis=(1, 2)), np.ones(residuals.shape)
    shrink = 1 / (1 + squares / ROBUST_SCALE**2)
    return (squares * shrink)[:, 1:].sum(axis=(1, 2)), shrink**2


def _step(
    residuals: Float64[np.ndarray, "m r n"],
    jacobian: Float64[np.ndarray, "m 6 r n"],
    weights: Float64[np.ndarray, "m r n"],
    damping: Float64[np.ndarray, " m"],
) -> Float64[np.ndarray, "m 6"]:
    flat = jacobian.reshape(len(jacobian), 6, -1)
    weighted = (jacobian * weights[:, None]).reshape(flat.shape)
    normal = weighted @ np.swapaxes(flat, 1, 2)
    diagonal = normal.reshape(len(normal), 36)[:, ::7]  # a view
    diagonal += damping[:, None] * diagonal + 1e-12
    slope = weighted @ residuals.reshape(len(residuals), -1, 1)
    return -np.linalg.solve(normal, slope)[..., 0]


def _moved(poses: Poses, step: Float64[np.ndarray, "m 6"]) -> Poses:
    moved = poses.copy()
    moved[:, :3, :3] = small_rotations(step[:, :3]) @ poses[:, :3, :3]
    moved[:, :3, 3] += step[:, 3:]
    return moved
