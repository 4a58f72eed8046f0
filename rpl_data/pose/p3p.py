"""Compute poses from three points each (P3P), for many triples at once.

Grunert's equations as in Haralick, Lee, Ottenberg and Nolle, "Review and analysis of solutions of the three
point perspective pose estimation problem", IJCV 13 (1994), section 3.1: the ratio of two distances from the
camera is a root of a quartic. Noise can make a pair of roots complex; their real part is still used, since
the caller ranks the poses by all of its points.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from rpl_data.pose.algebra import cross, quartic_roots


def poses_from_triples(
    points_object: Float64[np.ndarray, "m 3 3"], rays_camera: Float64[np.ndarray, "m 3 3"]
) -> Float64[np.ndarray, "p 4 4"]:
    """Compute ``camera_from_object`` for every solution of every triple, at most four per triple.

    Args:
        points_object: three points in rows, metres, object frame.
        rays_camera: directions in which they are seen, z = 1.
    """
    unit = rays_camera / np.sqrt(np.vecdot(rays_camera, rays_camera))[..., None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        distances_m = _distances(points_object, unit)
        usable = (distances_m > 0).all(axis=-1)  # False for NaN
        triple = np.flatnonzero(usable) // 4
        points_camera = distances_m[usable][..., None] * unit[triple]
        rotations = _axes(points_camera) @ np.swapaxes(_axes(points_object), -1, -2)[triple]
    poses = np.zeros((len(triple), 4, 4))
    poses[:, :3, :3], poses[:, 3, 3] = rotations, 1
    poses[:, :3, 3] = points_camera[:, 0] - (rotations @ points_object[triple, 0, :, None])[..., 0]
    solutions: Float64[np.ndarray, "p 4 4"] = poses[np.isfinite(poses.sum(axis=(1, 2)))]
    return solutions


def _distances(
    points: Float64[np.ndarray, "m 3 3"], unit: Float64[np.ndarray, "m 3 3"]
) -> Float64[np.ndarray, "m 4 3"]:
    """Distances of the three points from the camera, for the four solutions of each triple; NaN if none."""
    sides = points[:, [1, 0, 0]] - points[:, [2, 2, 1]]
    aa, bb, cc = np.vecdot(sides, sides).T
    alpha, beta, gamma = np.vecdot(unit[:, [1, 0, 0]], unit[:, [2, 2, 1]]).T
    a, c = aa / bb, cc / bb  # squared sides, relative to that between points 1 and 3
    q = a - c
    v = quartic_roots(
        (1 + q) ** 2 - 4 * a * gamma**2,
        4 * (-q * (1 + q) * beta + 2 * a * gamma**2 * beta - (1 - a - c) * alpha * gamma),
        2
        * (
            q**2
            - 1
            + 2 * q**2 * beta**2
            + 2 * (1 - c) * alpha**2
            - 4 * (a + c) * alpha * beta * gamma
            + 2 * (1 - a) * gamma**2
        ),
        4 * (q * (1 - q) * beta - (1 - a - c) * alpha * gamma + 2 * c * alpha**2 * beta),
        (q - 1) ** 2 - 4 * c * alpha**2,
    )
    q, alpha, beta, gamma, bb = (x[:, None] for x in (q, alpha, beta, gamma, bb))
    u = ((q - 1) * v**2 - 2 * q * beta * v + 1 + q) / (2 * (gamma - v * alpha))
    first = np.sqrt(bb / (1 + v**2 - 2 * v * beta))
    return np.stack([first, u * first, v * first], axis=-1)


def _axes(points: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """A right-handed frame, in columns, that moves with three points given in rows."""
    x = points[..., 1, :] - points[..., 0, :]
    x = x / np.sqrt(np.vecdot(x, x))[..., None]
    z = cross(x, points[..., 2, :] - points[..., 0, :])
    z = z / np.sqrt(np.vecdot(z, z))[..., None]
    return np.stack([x, cross(z, x), z], axis=-1)
