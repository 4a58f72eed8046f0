"""Spheres in which surfaces are fused, joined where they overlap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rpl_data.geometry import Sphere


def joined_spheres(spheres: Sequence[Sphere]) -> list[Sphere]:
    """Join spheres that overlap, so that no surface is fused twice."""
    joined: list[Sphere] = []
    for sphere in spheres:
        while touching := [n for n, other in enumerate(joined) if _overlap(sphere, other)]:
            sphere = _around(sphere, joined.pop(touching[0]))
        joined.append(sphere)
    return joined


def _overlap(a: Sphere, b: Sphere) -> bool:
    return float(np.linalg.norm(a.centre_m - b.centre_m)) < a.radius_m + b.radius_m


def _around(a: Sphere, b: Sphere) -> Sphere:
    """The smallest sphere that contains both."""
    distance = float(np.linalg.norm(b.centre_m - a.centre_m))
    if distance + b.radius_m <= a.radius_m:
        return a
    if distance + a.radius_m <= b.radius_m:
        return b
    radius = (distance + a.radius_m + b.radius_m) / 2
    return Sphere(a.centre_m + (b.centre_m - a.centre_m) * (radius - a.radius_m) / distance, radius)
