"""Compute poses from three points each (P3P), in compiled code; importing this module imports numba.

Grunert's equations as in Haralick, Lee, Ottenberg and Nolle, "Review and analysis of solutions of the three
point perspective pose estimation problem", IJCV 13 (1994), section 3.1: the ratio of two distances from the
camera is a root of a quartic. Noise can make a pair of roots complex; their real part is still used, since
the caller ranks the poses by all of its points.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float64

from rpl_data.compiled import compiled
from rpl_data.pose.quartic import quartic_roots
from rpl_data.pose.vectors import Vector, cross, difference, dot, normalized, scaled


def poses_from_triples(
    points_object: Float64[np.ndarray, "m 3 3"], rays_camera: Float64[np.ndarray, "m 3 3"]
) -> Float64[np.ndarray, "p 4 4"]:
    """Compute ``camera_from_object`` for every solution of every triple, at most four per triple.

    Args:
        points_object: three points in rows, metres, object frame.
        rays_camera: directions in which they are seen, z = 1.
    """
    poses = np.zeros((4 * len(points_object), 4, 4))
    count = _write_poses(np.ascontiguousarray(points_object), np.ascontiguousarray(rays_camera), poses)
    solutions: Float64[np.ndarray, "p 4 4"] = poses[:count]
    return solutions


@compiled
def _write_poses(points: Any, rays: Any, poses: Any) -> int:
    """Write the poses of all triples one after another; how many there are."""
    count = 0
    for row in range(len(points)):
        one, two, three = _rows(points[row])
        ray_one, ray_two, ray_three = _rows(rays[row])
        units = normalized(ray_one), normalized(ray_two), normalized(ray_three)
        axes = _axes(one, two, three)
        for first, second, third in _distances((one, two, three), units):
            if first > 0 and second > 0 and third > 0:  # not so for NaN
                corner = scaled(units[0], first)
                seen = _axes(corner, scaled(units[1], second), scaled(units[2], third))
                if _write_pose(axes, seen, one, corner, poses[count]):
                    count += 1
    return count


@compiled
def _distances(points: tuple[Vector, Vector, Vector], units: tuple[Vector, Vector, Vector]) -> Any:
    """Distances of the three points from the camera, four solutions; NaN or negative where there is none.

    The names are those of the paper: a, b and c are the sides opposite the points, alpha, beta and gamma the
    cosines between the rays that look at their ends; v and u are the third and second distance by the first.
    """
    side_a, side_b = difference(points[1], points[2]), difference(points[0], points[2])
    side_c = difference(points[0], points[1])
    bb = dot(side_b, side_b)
    a, c = dot(side_a, side_a) / bb, dot(side_c, side_c) / bb  # both squared, and by b squared
    alpha, beta, gamma = dot(units[1], units[2]), dot(units[0], units[2]), dot(units[0], units[1])
    q = a - c
    rest = 1 - a - c
    roots = quartic_roots(
        (1 + q) ** 2 - 4 * a * gamma**2,
        4 * (-q * (1 + q) * beta + 2 * a * gamma**2 * beta - rest * alpha * gamma),
        2
        * (
            q**2
            - 1
            + 2 * q**2 * beta**2
            + 2 * (1 - c) * alpha**2
            - 4 * (a + c) * alpha * beta * gamma
            + 2 * (1 - a) * gamma**2
        ),
        4 * (q * (1 - q) * beta - rest * alpha * gamma + 2 * c * alpha**2 * beta),
        (q - 1) ** 2 - 4 * c * alpha**2,
    )
    return (
        _three_distances(roots[0], q, alpha, beta, gamma, bb),
        _three_distances(roots[1], q, alpha, beta, gamma, bb),
        _three_distances(roots[2], q, alpha, beta, gamma, bb),
        _three_distances(roots[3], q, alpha, beta, gamma, bb),
    )


@compiled
def _three_distances(v: float, q: float, alpha: float, beta: float, gamma: float, bb: float) -> Vector:
    u = ((q - 1) * v**2 - 2 * q * beta * v + 1 + q) / (2 * (gamma - v * alpha))
    first = (bb / (1 + v**2 - 2 * v * beta)) ** 0.5
    return first, u * first, v * first


@compiled
def _rows(matrix: Any) -> tuple[Vector, Vector, Vector]:
    return (
        (matrix[0, 0], matrix[0, 1], matrix[0, 2]),
        (matrix[1, 0], matrix[1, 1], matrix[1, 2]),
        (matrix[2, 0], matrix[2, 1], matrix[2, 2]),
    )


@compiled
def _axes(one: Vector, two: Vector, three: Vector) -> tuple[Vector, Vector, Vector]:
    """x, y and z of a right-handed frame that moves with three points."""
    x = normalized(difference(two, one))
    z = normalized(cross(x, difference(three, one)))
    return x, cross(z, x), z


@compiled
def _write_pose(axes: Any, axes_seen: Any, point: Vector, point_seen: Vector, pose: Any) -> bool:
    """Write the pose that brings the axes and the point to where they are seen; False if it is not finite."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            turned = (
                axes_seen[0][i] * axes[0][j] + axes_seen[1][i] * axes[1][j] + axes_seen[2][i] * axes[2][j]
            )
            pose[i, j] = turned
        pose[i, 3] = point_seen[i] - (pose[i, 0] * point[0] + pose[i, 1] * point[1] + pose[i, 2] * point[2])
        total += pose[i, 0] + pose[i, 1] + pose[i, 2] + pose[i, 3]
    pose[3, 3] = 1
    return bool(np.isfinite(total))
