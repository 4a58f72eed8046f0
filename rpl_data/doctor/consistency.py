"""Measure how well depth images agree with each other under the given poses.

A point seen in frame i and taken to frame j by the poses must lie at the depth that frame j measured. With
wrong poses, a wrong depth unit or wrong intrinsics it does not, and a fused surface would be blurred.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from rpl_data.geometry import invert, rays
from rpl_data.types import Intrinsics, spread_evenly

MAX_DIFFERENCE = 0.05
"""Relative differences of depth are clipped here: a larger one means another surface or a wrong pose."""

FEWEST_POINTS = 50
"""A pair of images with fewer common points is not judged."""


@dataclass(frozen=True)
class Geometry:
    """The camera geometry that relates depth images to one another.

    Attributes:
        intrinsics: intrinsics of the depth images.
        scene_from_camera: one pose per depth image; NaN where there is none.
        metres_factor: factor that corrects the depths.
        along_ray: whether depth is the distance along the ray of each pixel, not along the optical axis.
    """

    intrinsics: Intrinsics
    scene_from_camera: Float64[np.ndarray, "n 4 4"]
    metres_factor: float = 1.0
    along_ray: bool = False


@dataclass(frozen=True)
class ComparedImages:
    """Depth images, and the pairs of them that are compared.

    Attributes:
        depths_m: the depth images, 0 = none.
        grid_px: (u, v) of the pixels that are compared.
        pairs: row numbers (i, j) of the images in each pair.
        runs: (first, last + 1) row numbers of images that follow one another in the recording.
    """

    depths_m: Float32[np.ndarray, "n height width"]
    grid_px: Float64[np.ndarray, "points 2"]
    pairs: Int64[np.ndarray, "pairs 2"]
    runs: tuple[tuple[int, int], ...]


def choose_pairs(
    depths_m: Float32[np.ndarray, "n height width"],
    runs: Sequence[tuple[int, int]],
    *,
    columns: int = 50,
    most_pairs: int = 40,
) -> ComparedImages:
    """Choose pairs of images 1/8, 1/4 and 1/2 of a run apart, at most `most_pairs`, evenly."""
    _, height, width = depths_m.shape
    grid = max(1, width // columns)
    v, u = np.mgrid[grid // 2 : height : grid, grid // 2 : width : grid]
    pairs = [
        (i, i + gap)
        for first, behind in runs
        for gap in sorted({max(1, (behind - first) // part) for part in (8, 4, 2)})
        for i in range(first, behind - gap)
    ]
    rows = np.array(spread_evenly(pairs, most_pairs), dtype=np.int64).reshape(-1, 2)
    return ComparedImages(depths_m, np.column_stack([u.ravel(), v.ravel()]).astype(float), rows, tuple(runs))


def differences(compared: ComparedImages, geometry: Geometry) -> Float64[np.ndarray, " pairs"]:
    """Median relative difference of depth for each pair of images.

    Differences are clipped at `MAX_DIFFERENCE`, and points that leave the image count as that, so that a pose
    that takes everything out of sight does not win. NaN for a pair without poses or with too little depth.
    """
    i, j = compared.pairs.T
    u, v = compared.grid_px.astype(int).T
    depth_m = compared.depths_m[i[:, None], v, u].astype(float) * geometry.metres_factor
    j_from_i = invert(geometry.scene_from_camera[j]) @ geometry.scene_from_camera[i]
    directions = rays(geometry.intrinsics, compared.grid_px)
    if geometry.along_ray:
        depth_m /= np.linalg.norm(directions, axis=1)
    points_i = directions * depth_m[..., None]
    points_j = points_i @ j_from_i[:, :3, :3].transpose(0, 2, 1) + j_from_i[:, None, :3, 3]
    found_m, inside = _looked_up(compared, j, geometry, points_j)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.minimum(np.abs(1 - found_m / points_j[..., 2]), MAX_DIFFERENCE)
    relative[~inside] = MAX_DIFFERENCE
    relative[(depth_m == 0) | (inside & (found_m == 0))] = np.nan
    relative[~np.isfinite(j_from_i).all(axis=(1, 2))] = np.nan
    return _medians(relative)


def _medians(values: Float64[np.ndarray, "rows n"]) -> Float64[np.ndarray, " rows"]:
    """Upper median of the numbers in each row; NaN where there are fewer than `FEWEST_POINTS`."""
    counts = np.isfinite(values).sum(axis=1)
    middle = np.sort(values, axis=1)[np.arange(len(values)), counts // 2 % values.shape[1]]  # NaN goes last
    return np.where(counts >= FEWEST_POINTS, middle, np.nan)


def _looked_up(
    compared: ComparedImages,
    rows: Int64[np.ndarray, " pairs"],
    geometry: Geometry,
    points_camera: Float64[np.ndarray, "pairs n 3"],
) -> tuple[Float64[np.ndarray, "pairs n"], Bool[np.ndarray, "pairs n"]]:
    """Look up the depth measured where each point projects (0 = none), and whether it is in the image.

    Lens distortion is ignored: what is sought here are factors, not pixels.
    """
    camera, z = geometry.intrinsics, points_camera[..., 2]
    _, height, width = compared.depths_m.shape
    ahead = np.where(z > 1e-3, z, np.inf)
    u = camera.fx * points_camera[..., 0] / ahead + camera.cx
    v = camera.fy * points_camera[..., 1] / ahead + camera.cy
    inside = np.isfinite(ahead) & (u > 0) & (u < width - 1) & (v > 0) & (v < height - 1)
    column, row = (np.rint(np.where(inside, number, 0)).astype(int) for number in (u, v))
    found_m = np.where(inside, compared.depths_m[rows[:, None], row, column].astype(float), 0.0)
    if geometry.along_ray:
        x, y = (column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy
        found_m /= np.sqrt(1 + x**2 + y**2)
    return found_m * geometry.metres_factor, inside
