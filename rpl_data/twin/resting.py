"""Find the poses in which a rigid thing can rest on a table."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

GIVE = 0.003
"""Points this close to the lowest plane touch the table, as a share of the size: nothing is quite flat."""


def resting_rotations(
    vertices: Float64[np.ndarray, "n 3"], *, steady_deg: float = 6.0, unlike_deg: float = 25.0
) -> list[Float64[np.ndarray, "3 3"]]:
    """Find `table_from_object` rotations in which a rigid thing stands stably, unlike one another.

    It rests on a face of its convex hull if the centre of mass (here: of the hull) is above that face and
    stays so when the table tilts by `steady_deg` (Goldberg et al., IJRR 18, 1999). The most stable comes
    first, then always the one most unlike those before it.
    """
    hull = ConvexHull(vertices)
    corners = vertices[hull.vertices]
    centre, size_m = _centroid(hull), float(np.linalg.norm(np.ptp(corners, axis=0)))
    steady, downs = [], []
    for normal, offset in {tuple(np.round(e[:3], 2)): (e[:3], e[3]) for e in hull.equations}.values():
        rotation = _turning_down(normal)
        on_plane = corners[np.abs(corners @ normal + offset) < GIVE * size_m]
        angle = _steadiness_rad(on_plane @ rotation.T, centre @ rotation.T)
        if angle > np.deg2rad(steady_deg):
            steady.append(angle)
            downs.append(normal)
    order = _most_unlike(np.array(downs).reshape(-1, 3), np.array(steady), np.deg2rad(unlike_deg))
    return [_turning_down(downs[number]) for number in order]


def _centroid(hull: ConvexHull) -> Float64[np.ndarray, "3"]:
    """Centre of mass of the hull, filled evenly: tetrahedra from an inner point to its faces."""
    inside = hull.points[hull.vertices].mean(axis=0)
    a, b, c = (hull.points[hull.simplices[:, i]] - inside for i in range(3))
    volume = np.abs(np.einsum("nk,nk->n", a, np.cross(b, c)))
    centre: Float64[np.ndarray, "3"] = inside + (volume @ (a + b + c) / 4) / volume.sum()
    return centre


def _most_unlike(
    downs: Float64[np.ndarray, "n 3"], steady_rad: Float64[np.ndarray, " n"], unlike_rad: float
) -> list[int]:
    """Order directions at least `unlike_rad` apart: the most stable, then the farthest from all before."""
    order: list[int] = [int(np.argmax(steady_rad))] if len(downs) else []
    while order:
        apart = np.arccos((downs @ downs[order].T).clip(-1, 1)).min(axis=1).round(2)
        if apart.max() < unlike_rad:
            break
        order.append(int(np.lexsort((steady_rad, apart))[-1]))
    return order


def _turning_down(normal: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """A rotation that takes the direction to -z."""
    rotation, _ = Rotation.align_vectors([[0.0, 0.0, -1.0]], [normal])
    matrix: Float64[np.ndarray, "3 3"] = rotation.as_matrix()
    return matrix


def _steadiness_rad(base: Float64[np.ndarray, "n 3"], centre: Float64[np.ndarray, "3"]) -> float:
    """The tilt at which a thing on that base falls over; negative when it does not stand at all."""
    if len(base) < 3 or np.linalg.svd(base[:, :2] - base[:, :2].mean(axis=0), compute_uv=False)[1] < 1e-3:
        return -1.0
    edges = ConvexHull(base[:, :2]).equations
    inside_m = -(edges[:, :2] @ centre[:2] + edges[:, 2]).max()
    return float(np.arctan2(inside_m, centre[2] - base[:, 2].mean()))
