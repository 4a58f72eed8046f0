"""Levenberg-Marquardt for one pose, in compiled code; importing this module imports numba.

A step moves a pose by a rotation vector w and a translation d in the camera frame,
``x -> exp(w) R x + t + d``. `given` is the tuple of arrays that `refine` makes of `Correspondences`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rpl_data.compiled import compiled
from rpl_data.geometry import NEAREST_M

ROBUST_SCALE = 3.0
"""Residuals beyond this many standard deviations lose weight fastest (Geman-McClure)."""

SMALLEST_STEP = 1e-3
"""Radians and metres: a smaller step is still made, but is the last. Two pixels of noise leave an
uncertainty many times as large, and near the end steps shrink more than tenfold."""


@compiled
def minimize(pose: Any, given: Any, robust: bool, iterations: int) -> bool:
    """Move a pose to a local minimum of the cost; False when the residuals leave a direction of it free."""
    normal, slope, step = np.empty((6, 6)), np.empty(6), np.empty(6)
    tried, tried_normal, tried_slope = pose.copy(), np.empty((6, 6)), np.empty(6)
    cost = write_normal_equations(pose, given, robust, normal, slope)
    damping = 1e-3
    for _ in range(iterations):
        if not _solve(normal, slope, damping, step):
            return False
        move(pose, step, tried)
        if _largest(step) < SMALLEST_STEP:
            _copy(tried, pose)
            return True
        tried_cost = write_normal_equations(tried, given, robust, tried_normal, tried_slope)
        if tried_cost < cost:
            cost = tried_cost
            _copy(tried, pose)
            normal, tried_normal = tried_normal, normal
            slope, tried_slope = tried_slope, slope
            damping *= 0.1
        else:
            damping *= 10
    return True


@compiled
def _largest(step: Any) -> float:
    largest = 0.0
    for number in step:
        largest = max(largest, abs(number))
    return largest


@compiled
def _copy(pose: Any, into: Any) -> None:
    for i in range(3):
        for j in range(4):
            into[i, j] = pose[i, j]


@compiled
def write_normal_equations(pose: Any, given: Any, robust: bool, normal: Any, slope: Any) -> float:
    """Write ``J^T W J`` and ``J^T W r`` of the residuals r by (w, d), and return the cost.

    The residuals have unit variance. u and v share a robust weight, depth has its own. With a = R x,
    p = a + t and b = dr/dp: dr/dd = b and dr/dw = a x b.
    """
    points, positions_px, focal_px, whitening, depth_m, depth_sigma_m = given
    for i in range(6):
        slope[i] = 0.0
        for j in range(6):
            normal[i, j] = 0.0
    by_u, by_v, by_z = np.zeros(6), np.zeros(6), np.zeros(6)
    total = 0.0
    for row in range(len(points)):
        ax, ay, az = turned(pose, points[row])
        z = max(az + pose[2, 3], NEAREST_M)  # a point behind costs so much that the step is rejected
        by_x, by_y = focal_px[0] / z, focal_px[1] / z
        u, v = by_x * (ax + pose[0, 3]), by_y * (ay + pose[1, 3])
        du, dv = -u / z, -v / z
        by_u[0], by_u[1], by_u[2], by_u[3], by_u[5] = ay * du, az * by_x - ax * du, -ay * by_x, by_x, du
        by_v[0], by_v[1], by_v[2], by_v[4], by_v[5] = ay * dv - az * by_y, -ax * dv, ax * by_y, by_y, dv
        by_v[3] = 0.0
        off_u, off_v = u - positions_px[row, 0], v - positions_px[row, 1]
        for k in range(6):  # the whitening is lower triangular
            by_v[k] = whitening[row, 1, 0] * by_u[k] + whitening[row, 1, 1] * by_v[k]
            by_u[k] *= whitening[row, 0, 0]
        off_v = whitening[row, 1, 0] * off_u + whitening[row, 1, 1] * off_v
        off_u *= whitening[row, 0, 0]
        cost, weight = cost_and_weight(off_u * off_u + off_v * off_v, robust)
        total += cost
        _add(by_u, off_u, weight, normal, slope)
        _add(by_v, off_v, weight, normal, slope)
        if np.isfinite(depth_m[row]):
            sharpness = 1 / depth_sigma_m[row]
            by_z[0], by_z[1], by_z[5] = ay * sharpness, -ax * sharpness, sharpness
            off_z = (z - depth_m[row]) * sharpness
            cost, weight = cost_and_weight(off_z * off_z, robust)
            total += cost
            _add(by_z, off_z, weight, normal, slope)
    return total


@compiled
def turned(pose: Any, point: Any) -> tuple[float, float, float]:
    """A point, rotated by a pose without its translation."""
    return (
        pose[0, 0] * point[0] + pose[0, 1] * point[1] + pose[0, 2] * point[2],
        pose[1, 0] * point[0] + pose[1, 1] * point[1] + pose[1, 2] * point[2],
        pose[2, 0] * point[0] + pose[2, 1] * point[1] + pose[2, 2] * point[2],
    )


@compiled
def cost_and_weight(square: float, robust: bool) -> tuple[float, float]:
    """Cost of a squared residual, and the weight that gives the same derivative."""
    if not robust:
        return square, 1.0
    shrink = 1 / (1 + square / ROBUST_SCALE**2)
    return square * shrink, shrink * shrink


@compiled
def _add(by: Any, off: float, weight: float, normal: Any, slope: Any) -> None:
    """Add a residual and its derivatives."""
    for i in range(6):
        weighted = weight * by[i]
        slope[i] += weighted * off
        for j in range(6):
            normal[i, j] += weighted * by[j]


@compiled
def _solve(normal: Any, slope: Any, damping: float, step: Any) -> bool:
    """Write the damped step (by Cholesky's factors); False when the equations have no single solution."""
    lower = np.empty((6, 6))
    for i in range(6):
        for j in range(i + 1):
            rest = normal[i, j]
            if i == j:
                rest += damping * normal[i, i] + 1e-12
            for k in range(j):
                rest -= lower[i, k] * lower[j, k]
            if i > j:
                lower[i, j] = rest / lower[j, j]
            elif rest > 0:
                lower[i, i] = np.sqrt(rest)
            else:  # also where it is NaN
                return False
    for i in range(6):
        rest = -slope[i]
        for k in range(i):
            rest -= lower[i, k] * step[k]
        step[i] = rest / lower[i, i]
    for i in range(5, -1, -1):
        rest = step[i]
        for k in range(i + 1, 6):
            rest -= lower[k, i] * step[k]
        step[i] = rest / lower[i, i]
    return True


@compiled
def move(pose: Any, step: Any, moved: Any) -> None:
    """Write the moved pose. Its turn equals exp(w) to second order and is a rotation for any w.

    Cayley's map: the unit quaternion along (1, w / 2).
    """
    w = 1 / np.sqrt(1 + 0.25 * (step[0] * step[0] + step[1] * step[1] + step[2] * step[2]))
    x, y, z = 0.5 * w * step[0], 0.5 * w * step[1], 0.5 * w * step[2]
    turn = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    for i in range(3):
        for j in range(3):
            moved[i, j] = turn[i][0] * pose[0, j] + turn[i][1] * pose[1, j] + turn[i][2] * pose[2, j]
        moved[i, 3] = pose[i, 3] + step[3 + i]
