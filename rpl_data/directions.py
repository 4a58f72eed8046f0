"""Directions spread over a sphere, and how many of them views of an object cover."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float64
from scipy.spatial import cKDTree

from rpl_data.geometry import Transform, invert

Directions = Float64[np.ndarray, "_ 3"]
"""Unit vectors; of views: from the object to the camera, object frame."""

COVERED_DEG = 15.0
"""A direction is covered when a view lies within this angle of it."""
COMPARED = 2000
"""Directions that are compared with the views, about 4.5 degrees apart."""


def view_direction(camera_from_object: Transform) -> Float64[np.ndarray, "3"]:
    """Unit vector from the origin of an object to the camera, object frame."""
    towards = invert(camera_from_object)[:3, 3]
    unit: Float64[np.ndarray, "3"] = towards / np.linalg.norm(towards)
    return unit


@lru_cache
def spread_directions(count: int) -> Directions:
    """Directions spread evenly, on a Fibonacci spiral; the array is shared and read-only."""
    number = np.arange(count) + 0.5
    z = 1 - 2 * number / count
    turn = np.pi * (1 + np.sqrt(5)) * number
    across = np.sqrt(1 - z**2)
    found: Directions = np.column_stack([across * np.cos(turn), across * np.sin(turn), z])
    found.flags.writeable = False
    return found


def nearest_spread(count: int, direction: Float64[np.ndarray, "3"]) -> int:
    """The number of the one of `spread_directions(count)` that is nearest to a direction."""
    return int(_spread_tree(count).query(direction)[1])


@lru_cache
def _spread_tree(count: int) -> cKDTree:
    return cKDTree(spread_directions(count))


def gaps_deg(views: Directions) -> Float64[np.ndarray, "_"]:
    """Angle between each of the directions over the sphere and the view nearest to it; 180 without views."""
    if not len(views):
        return np.full(COMPARED, 180.0)
    chord = cKDTree(views).query(spread_directions(COMPARED))[0]
    return np.asarray(np.degrees(2 * np.arcsin(np.clip(chord / 2, 0, 1))))


def coverage(views: Directions) -> float:
    """Share of all directions that lie within `COVERED_DEG` of a view, 0 to 1."""
    return float((gaps_deg(views) <= COVERED_DEG).mean())
