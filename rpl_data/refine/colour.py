"""What the print on a surface looks like, told apart from the light that falls on it.

A bottle, a bowl or a box slides freely along its own surface as far as geometry goes; its print does not.
Scenes are lit differently, so colours are compared as logarithms (a change of exposure is then a constant)
from which their surroundings' mean is taken off.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import cKDTree

from rpl_data.types import PointCloud

PRINT_M = 0.004
"""Radius over which colours are smoothed: about a voxel of the fused surface."""
SURROUNDINGS_M = 0.02
"""Radius of the surroundings whose mean is taken off."""
FITTED_M = 0.006
"""Radius of the neighbourhood that a gradient is fitted to."""
DARKEST = 10.0
"""Added to 8-bit colours before the logarithm: below it a sensor measures noise."""


class Texture(NamedTuple):
    """The print at points of a surface: brightness and two hues (C = 3), or nothing (C = 0).

    Attributes:
        values: without unit, 0 in the mean of every point's surroundings.
        gradients: their derivative by position, per metre, along the surface.
    """

    values: Float64[np.ndarray, "n c"]
    gradients: Float64[np.ndarray, "n c 3"]


class _Neighbours(NamedTuple):
    """Pairs of points of the same side of a surface, each pair in both orders."""

    one: Int64[np.ndarray, " m"]
    other: Int64[np.ndarray, " m"]


def texture_of(cloud: PointCloud) -> Texture:
    """The print of a surface; without channels when the cloud has no colours."""
    count = len(cloud.points)
    if cloud.colors is None:
        return Texture(np.empty((count, 0)), np.empty((count, 0, 3)))
    tree = cKDTree(cloud.points)
    channels = _channels(cloud.colors.astype(float))
    values = _blurred(cloud, tree, channels, PRINT_M) - _blurred(cloud, tree, channels, SURROUNDINGS_M)
    return Texture(values, _gradients(cloud, tree, values))


def _channels(colors: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """Brightness, red against green, and blue against green, as logarithms."""
    brightness = np.log(colors @ [0.299, 0.587, 0.114] + DARKEST)
    red, green, blue = np.log(colors + DARKEST).T
    return np.column_stack([brightness, red - green, blue - green])


def _neighbours(cloud: PointCloud, tree: cKDTree, radius_m: float) -> _Neighbours:
    pairs = tree.query_pairs(radius_m, output_type="ndarray")
    same_side = (cloud.normals[pairs[:, 0]] * cloud.normals[pairs[:, 1]]).sum(axis=1) > 0.5
    a, b = pairs[same_side].astype(np.int64).T
    return _Neighbours(np.concatenate([a, b]), np.concatenate([b, a]))


def _summed(at: Int64[np.ndarray, " m"], terms: np.ndarray, count: int) -> np.ndarray:
    """Columns of terms added up at each of `count` points."""
    return np.column_stack([np.bincount(at, weights=column, minlength=count) for column in terms.T])


def _blurred(
    cloud: PointCloud, tree: cKDTree, values: Float64[np.ndarray, "n c"], radius_m: float
) -> Float64[np.ndarray, "n c"]:
    """Gaussian mean over the neighbourhood on the same side; sigma is half the radius."""
    one, other = _neighbours(cloud, tree, radius_m)
    squared = ((cloud.points[one] - cloud.points[other]) ** 2).sum(axis=1)
    weight = np.exp(-2 * squared / radius_m**2)
    total = 1 + np.bincount(one, weights=weight, minlength=len(values))
    mean: Float64[np.ndarray, "n c"] = (
        values + _summed(one, weight[:, None] * values[other], len(values))
    ) / total[:, None]
    return mean


def _gradients(
    cloud: PointCloud, tree: cKDTree, values: Float64[np.ndarray, "n c"]
) -> Float64[np.ndarray, "n c 3"]:
    """Least-squares slope of the values in each point's tangent plane."""
    one, other = _neighbours(cloud, tree, FITTED_M)
    count = len(values)
    offset = cloud.points[other] - cloud.points[one]
    offset -= (offset * cloud.normals[one]).sum(axis=1)[:, None] * cloud.normals[one]
    products = np.einsum("mi,mj->mij", offset, offset).reshape(-1, 9)
    moments = _summed(one, products, count).reshape(-1, 3, 3)
    # The slope along the normal is not known: it is held at 0, and so is that of a lone point.
    held = np.einsum("ni,nj->nij", cloud.normals, cloud.normals) * 1e-4 + 1e-8 * np.eye(3)
    change = values[other] - values[one]
    sides = [_summed(one, offset * column[:, None], count) for column in change.T]
    slopes: Float64[np.ndarray, "n c 3"] = np.linalg.solve(
        (moments + held)[:, None], np.stack(sides, axis=1)[..., None]
    )[..., 0]
    return slopes
