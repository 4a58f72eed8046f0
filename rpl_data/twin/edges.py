"""Find the pixels of a rendered image that need anti-aliasing, and the light that reaches them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, Int64

CORNERS = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))
"""Positions of the four rays within an edge pixel: a rotated grid."""


def find_edges(
    thing: Int64[np.ndarray, "height width"],
    normals: Float32[np.ndarray, "height width 3"],
    depth_m: Float32[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:
    """Pixels next to another surface, another face or a jump in depth; both sides of each edge."""
    edges = np.zeros(thing.shape, dtype=bool)
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        bend = np.einsum("hwk,hwk->hw", normals[here], normals[there]) < 0.9
        step = np.abs(depth_m[here] - depth_m[there]) > 0.02 * depth_m[here] + 0.005
        change = (thing[here] != thing[there]) | bend | step
        edges[here] |= change
        edges[there] |= change
    return edges


def of_neighbours(
    thing: Int64[np.ndarray, "height width"],
    values: Float32[np.ndarray, "height width 2"],
    rows: Int64[np.ndarray, " n"],
    columns: Int64[np.ndarray, " n"],
    wanted: Int64[np.ndarray, " n"],
) -> Float32[np.ndarray, "n 2"]:
    """Values of the pixel, or of its first neighbour, that shows the wanted surface; 1 where none does."""
    found = np.ones((len(rows), 2), np.float32)
    open_ = np.ones(len(rows), dtype=bool)
    for dv, du in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        v = (rows + dv).clip(0, thing.shape[0] - 1)
        u = (columns + du).clip(0, thing.shape[1] - 1)
        here = open_ & (thing[v, u] == wanted)
        found[here] = values[v[here], u[here]]
        open_ &= ~here
    return found
