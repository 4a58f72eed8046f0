"""A mesh with a grid of colours on every triangle, finer than its vertices.

The triangles of a dense model are some 2 mm wide, and a camera sees more than that. Each triangle carries the
colours of ``(n + 1)(n + 2) / 2`` points (texels) on a grid of n steps along its edges.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Float64, Int64, UInt8

from rpl_data.files import decoding, read_bytes, write_bytes
from rpl_data.geometry import Points
from rpl_data.types import Mesh

TEXEL_M = 0.0008
"""Wanted distance of neighbouring texels: a camera with a focal length of 600 px sees 1 mm from 0.6 m."""
MOST_STEPS = 6


@dataclass(frozen=True)
class PaintedMesh:
    """Triangles with texels; metres, object frame.

    Attributes:
        texels: RGB of the points of each triangle's grid, in the order of `grid`.
        seen: for each triangle, whether its shape and colours were seen; the others are a guess.
    """

    vertices: Float64[np.ndarray, "n 3"]
    triangles: Int64[np.ndarray, "m 3"]
    texels: UInt8[np.ndarray, "m t 3"]
    seen: Bool[np.ndarray, " m"]

    @property
    def mesh(self) -> Mesh:
        """The triangles alone."""
        return Mesh(self.vertices, self.triangles)

    def texel_at(
        self, triangle: Int64[np.ndarray, " k"], uv: Float[np.ndarray, "k 2"]
    ) -> Int64[np.ndarray, " k"]:
        """The texel nearest to barycentric coordinates of triangles, as `raycast.Hits` has them.

        It is a row of the texels, triangle after triangle.
        """
        each = self.texels.shape[1]
        steps = steps_of(each)
        i, j = np.rint(np.clip(uv, 0, 1) * np.float32(steps)).astype(np.int64).T
        found: Int64[np.ndarray, " k"] = triangle * each + _numbers(steps)[i, j]
        return found


def grid(steps: int) -> Float64[np.ndarray, "t 2"]:
    """Barycentric coordinates (u, v) of a triangle's texels: those of its second and third corner."""
    return np.array([(i, j) for i in range(steps + 1) for j in range(steps + 1 - i)], dtype=float) / steps


def steps_of(texels: int) -> int:
    """Steps of the grid that has so many points."""
    return (math.isqrt(8 * texels + 1) - 3) // 2


@lru_cache
def _numbers(steps: int) -> Int64[np.ndarray, "s s"]:
    """The number of the texel (i, j); beyond the triangle's edge, where rounding may lead, one on it."""
    number = np.zeros((steps + 1, steps + 1), np.int64)
    for k, (i, j) in enumerate(np.rint(grid(steps) * steps).astype(int)):
        number[i, j] = k
    for i in range(steps + 1):
        number[i, steps + 1 - i :] = number[i, steps - i]
    return number


def steps_for(mesh: Mesh, *, texel_m: float = TEXEL_M) -> int:
    """Steps by which the texels of the mesh are about so far apart."""
    corners = mesh.vertices[mesh.triangles]
    edge_m = float(np.median(np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)))
    return int(np.clip(np.ceil(edge_m / texel_m), 1, MOST_STEPS))


def texel_positions(mesh: Mesh, steps: int) -> Points:
    """Positions of all texels, triangle by triangle."""
    u, v = grid(steps).T
    weights = np.column_stack([1 - u - v, u, v])
    positions: Points = np.einsum("tc,mcd->mtd", weights, mesh.vertices[mesh.triangles]).reshape(-1, 3)
    return positions


def save_painted(path: Path, painted: PaintedMesh) -> None:
    """Write a NumPy archive, completely or not at all; the same mesh gives the same bytes."""
    content = io.BytesIO()
    np.savez(content, **vars(painted))
    write_bytes(path, content.getvalue())


def load_painted(path: Path) -> PaintedMesh:
    """Read what `save_painted` wrote; DataError when it is missing or damaged."""
    content = io.BytesIO(read_bytes(path))
    with (
        decoding(path, "make it again with `rpl synthesize --again true`"),
        np.load(content, allow_pickle=False) as stored,
    ):
        return PaintedMesh(**{name: stored[name] for name in PaintedMesh.__dataclass_fields__})
