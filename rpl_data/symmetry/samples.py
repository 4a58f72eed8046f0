"""Points drawn from an object's surface, with the colours of its print."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import cKDTree

from rpl_data.geometry import Points
from rpl_data.types import Mesh, PointCloud

DARKEST = 10.0
"""Added to colours (0 to 255) before their logarithm: below it a camera shows noise."""
SMOOTHED_OVER = 12
"""Neighbours over which normals are averaged."""


@dataclass(frozen=True)
class Samples:
    """Points spread evenly over a surface.

    Attributes:
        points: metres, object frame.
        normals: unit normals, outward.
        print: logarithms of lightness, and of red and blue against green; light and shade move the first
            only. None when the mesh has no colours.
        seen: whether a camera saw the surface there; elsewhere it is a guess.
    """

    points: Points
    normals: Points
    print: Float64[np.ndarray, "n 3"] | None
    seen: Bool[np.ndarray, " n"]


def drawn_samples(mesh: Mesh, seen_surface: PointCloud | None, *, count: int, seed: int) -> Samples:
    """Draw points uniformly by area, as `meshes.sampled` does, with smoothed normals and with colours.

    Args:
        seen_surface: points of the surface that cameras saw; None where all of the mesh is known.
    """
    generator = np.random.default_rng(seed)
    a, b, c = (mesh.vertices[mesh.triangles[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    twice_area = np.linalg.norm(across, axis=1)
    chosen = generator.choice(len(twice_area), size=count, p=twice_area / twice_area.sum())
    along, beside = np.sqrt(generator.random(count)), generator.random(count)
    weights = np.stack([1 - along, along * (1 - beside), along * beside], axis=1)
    corners = mesh.triangles[chosen]
    points = np.einsum("nc,ncd->nd", weights, mesh.vertices[corners])
    colors = None
    if mesh.colors is not None:
        colors = _print_of(np.einsum("nc,ncd->nd", weights, mesh.colors[corners].astype(float)))
    seen = np.ones(count, bool)
    if seen_surface is not None:
        gap = cKDTree(seen_surface.points).query(points)[0]
        seen = gap < 2 * _spacing_m(seen_surface.points)
    return Samples(points, _smoothed(points, across[chosen] / twice_area[chosen, None]), colors, seen)


def _smoothed(points: Points, normals: Points) -> Points:
    """Mean normal of the neighbours on the same side: small triangles of a noisy mesh point anywhere."""
    near = cKDTree(points).query(points, k=SMOOTHED_OVER)[1]
    same_side = np.einsum("nkd,nd->nk", normals[near], normals) > 0
    mean = np.einsum("nkd,nk->nd", normals[near], same_side.astype(float))
    return np.asarray(mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12))


def _print_of(colors: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    red, green, blue = np.log(colors + DARKEST).T
    return np.stack([(red + green + blue) / 3, red - green, blue - green], axis=1)


def part_of(samples: Samples, rows: slice) -> Samples:
    """Some of the samples."""
    print_ = None if samples.print is None else samples.print[rows]
    return Samples(samples.points[rows], samples.normals[rows], print_, samples.seen[rows])


def _spacing_m(points: Points) -> float:
    """Median distance of neighbours."""
    return float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))
