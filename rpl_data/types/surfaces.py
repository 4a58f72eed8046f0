"""Surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64, UInt8


@dataclass(frozen=True)
class Mesh:
    """Triangles, counter-clockwise seen from outside; metres.

    Attributes:
        colors: RGB of every vertex; None when unknown.
    """

    vertices: Float64[np.ndarray, "n 3"]
    triangles: Int64[np.ndarray, "m 3"]
    colors: UInt8[np.ndarray, "n 3"] | None = None


@dataclass(frozen=True)
class PointCloud:
    """Points with unit normals pointing out of the surface; metres."""

    points: Float64[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"]
    colors: UInt8[np.ndarray, "n 3"] | None = None
