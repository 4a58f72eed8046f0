"""What stands on the table of a scene: the fused surface, cut into things above the plane that holds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int64
from scipy.spatial import cKDTree

from rpl_data.geometry import Points
from rpl_data.meshes import select
from rpl_data.segment.region_growing import Plane, components, least_squares_plane, on_plane
from rpl_data.types import PointCloud

ON_PLANE_M = 0.006
"""Points this near to the plane belong to it."""
APART_M = 0.009
"""Points nearer to one another than this belong to the same thing."""
LEAST_POINTS = 60
PLANES_TRIED = 500
MOST_WINDOWS = 6


@dataclass(frozen=True)
class Things:
    """The things that stand on a plane, scene frame.

    Attributes:
        plane: normal upwards, to the side of the cameras.
        clouds: one per thing, the largest first.
    """

    plane: Plane
    clouds: list[PointCloud]


def things_on_support(surface: PointCloud, cameras: Points, *, seed: int = 0) -> Things | None:
    """Cut a surface into the things that stand on its largest plane; None where there is no plane.

    Args:
        surface: points of the scene near what the cameras look at, a few millimetres apart.
        cameras: centres of the cameras.
    """
    plane = _largest_plane(surface, cameras, np.random.default_rng(seed))
    if plane is None:
        return None
    above = select(surface, plane.height_m(surface.points) > ON_PLANE_M)
    if len(above.points) < LEAST_POINTS:
        return Things(plane, [])
    pairs = cKDTree(above.points).query_pairs(APART_M, output_type="ndarray").astype(np.int64)
    return Things(plane, _components(above, pairs))


def windows(thing: PointCloud, diameter_m: float) -> list[PointCloud]:
    """Balls of this diameter that cover a thing which is too large: things that touch one another are one."""
    centres = [thing.points[((thing.points - thing.points.mean(axis=0)) ** 2).sum(axis=1).argmin()]]
    away = np.linalg.norm(thing.points - centres[0], axis=1)
    while away.max() > diameter_m / 3 and len(centres) < MOST_WINDOWS:
        centres.append(thing.points[away.argmax()])
        away = np.minimum(away, np.linalg.norm(thing.points - centres[-1], axis=1))
    balls = [np.linalg.norm(thing.points - centre, axis=1) < diameter_m / 2 for centre in centres]
    return [select(thing, ball) for ball in balls if ball.sum() >= LEAST_POINTS]


def _components(cloud: PointCloud, pairs: Int64[np.ndarray, "m 2"]) -> list[PointCloud]:
    """The connected components with enough points, the largest first."""
    part = components(len(cloud.points), pairs)
    sizes = np.bincount(part)
    large = [n for n in np.argsort(-sizes) if sizes[n] >= LEAST_POINTS]
    return [select(cloud, part == n) for n in large]


def _largest_plane(surface: PointCloud, cameras: Points, generator: np.random.Generator) -> Plane | None:
    """The plane with most points (RANSAC over single oriented points), all cameras on its seen side."""
    points, normals = surface.points, surface.normals
    best, most = None, 0
    for n in generator.integers(0, len(points), PLANES_TRIED):
        plane = Plane(normals[n], float(normals[n] @ points[n]))
        count = int(_on(plane, surface).sum())
        if count > most and (plane.height_m(cameras) > 0).all():
            best, most = plane, count
    if best is None:
        return None
    for _ in range(3):
        best = least_squares_plane(best, points[_on(best, surface)])
    return best


def _on(plane: Plane, surface: PointCloud) -> Bool[np.ndarray, " n"]:
    return on_plane(plane, surface, ON_PLANE_M, least_cosine=0.9)
