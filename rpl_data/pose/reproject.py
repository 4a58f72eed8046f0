"""Reprojection errors of many poses, and their robust costs, in compiled code, which imports numba."""

from __future__ import annotations

from typing import Any

import numpy as np

from rpl_data.compiled import compiled
from rpl_data.geometry import NEAREST_M
from rpl_data.pose.minimize import cost_and_weight, turned


@compiled
def write_sigmas(poses: Any, given: Any, sigmas: Any) -> None:
    """Write the error of each keypoint (column) under each pose (row), in standard deviations.

    It is infinite behind the camera.
    """
    points, positions_px, focal_px, whitening, _, _ = given
    for n in range(len(poses)):
        pose = poses[n]
        for row in range(len(points)):
            ax, ay, az = turned(pose, points[row])
            z = az + pose[2, 3]
            if z > NEAREST_M:
                u = (ax + pose[0, 3]) / z * focal_px[0] - positions_px[row, 0]
                v = (ay + pose[1, 3]) / z * focal_px[1] - positions_px[row, 1]
                down = whitening[row, 1, 0] * u + whitening[row, 1, 1] * v
                sigmas[n, row] = np.sqrt((whitening[row, 0, 0] * u) ** 2 + down**2)
            else:
                sigmas[n, row] = np.inf


@compiled
def write_robust_costs(sigmas: Any, costs: Any) -> None:
    """Write the robust cost of each row; an infinite error costs as much as a very large one."""
    for n in range(len(sigmas)):
        total = 0.0
        for sigma in sigmas[n]:
            total += cost_and_weight(min(sigma, 1e6) ** 2, True)[0]
        costs[n] = total
