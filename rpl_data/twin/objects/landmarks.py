"""Choose points of a mesh that a person would click: corners and edges of its shape and of its print."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import cKDTree

from rpl_data.raycast import RayScene
from rpl_data.twin.surfaces import Surface
from rpl_data.types import DataError

NEIGHBOURHOOD = 0.04
"""Radius in which corners are sought, and their least distance, as a share of the mesh's diagonal."""
OPEN = 0.45
"""Share of all directions from which a landmark must be visible: 0.5 is a flat surface, less a hollow."""
CONTRAST = 0.5
"""Step of brightness, in both directions, that counts as much as the sharpest corner of the shape."""
DIRECTIONS = 200


def landmark_points(surface: Surface, count: int) -> Float64[np.ndarray, "count 3"]:
    """Choose vertices on corners that are visible from outside and well spread.

    A point is salient when the surface around it faces many ways, or when the print has a corner there. Of
    the most salient points, those are taken that are far from each other and leave no side without any.

    Raises:
        DataError: the mesh has fewer than `count` such points.
    """
    vertices = np.unique(surface.vertices[np.unique(surface.triangles)].round(6), axis=0)
    radius_m = NEIGHBOURHOOD * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    salience = _salience(surface, vertices, radius_m)
    peaks = _peaks(vertices, salience, radius_m)
    seen = _seen_from(surface, vertices[peaks])
    clear = np.flatnonzero(seen.mean(axis=1) > OPEN)[: max(6 * count, 20)]
    if len(clear) < count:
        raise DataError(f"the mesh shows only {len(clear)} corners or edges; ask for fewer than {count}")
    points = vertices[peaks[clear]]
    best: Float64[np.ndarray, "count 3"] = points[_chosen(points, salience[peaks[clear]], seen[clear], count)]
    return best


def _salience(
    surface: Surface, points: Float64[np.ndarray, "n 3"], radius_m: float
) -> Float64[np.ndarray, " n"]:
    """Measure how much each point is a corner of the shape (0 to 1) plus of the print (0 to 1)."""
    a, b, c = (surface.vertices[surface.triangles[:, i]] for i in range(3))
    near = cKDTree((a + b + c) / 3).query_ball_point(points, radius_m)
    shape = _eigenvalues(_normal_scatter(a, b, c), near)
    print_ = _eigenvalues(_print_scatter(surface, a, b, c), near)
    faces = shape.sum(axis=1) + 1e-15
    corner = (shape[:, 1] + 2 * shape[:, 0]) / faces  # three directions count more than two
    marked = (np.sqrt(print_[:, 1] / faces) * radius_m / CONTRAST).clip(0, 1)
    salience: Float64[np.ndarray, " n"] = corner / corner.max() + marked
    return salience


def _normal_scatter(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Float64[np.ndarray, "m 3 3"]:
    """Outer products of the normals, weighted by area: normal voting (Medioni, Lee & Tang, 2000)."""
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1) + 1e-15
    scatter: Float64[np.ndarray, "m 3 3"] = normals[:, :, None] * normals[:, None] / length[:, None, None]
    return scatter


def _print_scatter(
    surface: Surface, a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> Float64[np.ndarray, "m 3 3"]:
    """Outer products of the brightness gradients, weighted by area: Harris's structure tensor (1988)."""
    colors = surface.mesh.colors
    grey = np.zeros(len(surface.vertices)) if colors is None else colors.mean(axis=1) / 255
    values = grey[surface.triangles]
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)[:, None] + 1e-15
    normal = normal / area
    gradient = (
        values[:, :1] * np.cross(normal, c - b)
        + values[:, 1:2] * np.cross(normal, a - c)
        + values[:, 2:] * np.cross(normal, b - a)
    ) / area
    scatter: Float64[np.ndarray, "m 3 3"] = gradient[:, :, None] * gradient[:, None] * area[..., None]
    return scatter


def _eigenvalues(scatter: Float64[np.ndarray, "m 3 3"], near: np.ndarray) -> Float64[np.ndarray, "n 3"]:
    """Eigenvalues of the sum of the matrices around each point, ascending."""
    sums = np.stack([scatter[rows].sum(axis=0) if rows else np.zeros((3, 3)) for rows in near])
    values: Float64[np.ndarray, "n 3"] = np.linalg.eigvalsh(sums).clip(0)
    return values


def _peaks(
    points: Float64[np.ndarray, "n 3"], salience: Float64[np.ndarray, " n"], radius_m: float
) -> Int64[np.ndarray, " k"]:
    """Numbers of the points that are more salient than all within the radius, most salient first."""
    tree, free = cKDTree(points), np.ones(len(points), dtype=bool)
    kept = []
    for number in np.argsort(-salience):
        if free[number]:
            kept.append(int(number))
            free[tree.query_ball_point(points[number], radius_m)] = False
    return np.array(kept, dtype=np.int64)


def _seen_from(surface: Surface, points: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n directions"]:
    """Directions, evenly spread over the sphere, from which each point is visible."""
    rays = RayScene([surface.mesh], threads=1)
    turn = np.arange(DIRECTIONS) * np.pi * (3 - np.sqrt(5))  # Fibonacci lattice
    rise = 1 - (np.arange(DIRECTIONS) + 0.5) * 2 / DIRECTIONS
    out = np.stack([np.cos(turn) * np.sqrt(1 - rise**2), np.sin(turn) * np.sqrt(1 - rise**2), rise], -1)
    start = points[:, None] + 1e-3 * out[None]
    beams = np.concatenate([start, np.broadcast_to(out, start.shape)], axis=-1).reshape(-1, 6)
    return ~rays.occluded(beams.astype(np.float32), far=10.0).reshape(len(points), -1)


def _chosen(
    points: Float64[np.ndarray, "n 3"],
    salience: Float64[np.ndarray, " n"],
    seen: Bool[np.ndarray, "n directions"],
    count: int,
) -> list[int]:
    """Choose points one by one: salient, far from those before, and visible from where few of those are."""
    chosen: list[int] = []
    apart = np.linalg.norm(points - points.mean(axis=0), axis=1)
    for _ in range(count):
        wanted = 1 / (1 + seen[chosen].sum(axis=0)) ** 2
        chosen.append(int(np.argmax(apart * salience * (seen @ wanted))))
        apart = np.linalg.norm(points[:, None] - points[chosen][None], axis=-1).min(axis=1)
    return chosen
