"""The loops of `prints` and `print_alignment` over points, in compiled code; importing it imports numba."""

from __future__ import annotations

from typing import Any

import numpy as np

from rpl_data.compiled import compiled
from rpl_data.geometry import NEAREST_M
from rpl_data.label.compiled_edges import fill_motion


@compiled
def projected(a_from_b: Any, points: Any, fx: float, fy: float, cx: float, cy: float) -> Any:
    """Points moved into the frame of a camera without lens distortion, and their pixels, NaN behind it."""
    moved, uv_px = np.empty((len(points), 3)), np.empty((len(points), 2))
    for point in range(len(points)):
        for row in range(3):
            moved[point, row] = (
                a_from_b[row, 0] * points[point, 0]
                + a_from_b[row, 1] * points[point, 1]
                + a_from_b[row, 2] * points[point, 2]
                + a_from_b[row, 3]
            )
        x, y, z = moved[point, 0], moved[point, 1], moved[point, 2]
        ahead = z > NEAREST_M and np.isfinite(x) and np.isfinite(y) and np.isfinite(z)
        uv_px[point, 0] = x / z * fx + cx if ahead else np.nan
        uv_px[point, 1] = y / z * fy + cy if ahead else np.nan
    return moved, uv_px


@compiled
def seen_points(uv_px: Any, depth_m: Any, top: int, left: int, mesh_m: Any, inner: Any, most_m: float) -> Any:
    """Whether points are seen in a frame, as `Look.sees` has it.

    Args:
        depth_m: depths of the points.
        top, left: first row and column of the window.
        mesh_m, inner: depth of the label's mesh in the window, and its pixels that count.
        most_m: largest difference between the two depths.
    """
    height, width = inner.shape
    seen = np.zeros(len(uv_px), np.bool_)
    for point in range(len(uv_px)):
        column, row = np.rint(uv_px[point, 0]) - left, np.rint(uv_px[point, 1]) - top
        if 0 <= column < width and 0 <= row < height:  # not so for NaN
            at = int(row), int(column)
            seen[point] = inner[at] and abs(mesh_m[at] - depth_m[point]) < most_m
    return seen


@compiled
def value_at(patch: Any, u: float, v: float) -> float:
    """A value of a patch between its pixels, bilinear; beyond its border, that of the border."""
    height, width = patch.shape
    u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
    column, row = int(u), int(v)
    right, below = min(column + 1, width - 1), min(row + 1, height - 1)
    over, under = u - column, v - row
    upper = (1 - over) * patch[row, column] + over * patch[row, right]
    lower = (1 - over) * patch[below, column] + over * patch[below, right]
    return float((1 - under) * upper + under * lower)


@compiled
def values_at(patch: Any, uv_px: Any, corner: Any) -> Any:
    """Values of a patch that begins at that corner of the image, at finite pixels of the image."""
    values = np.empty(len(uv_px))
    for point in range(len(uv_px)):
        values[point] = value_at(patch, uv_px[point, 0] - corner[0], uv_px[point, 1] - corner[1])
    return values


@compiled
def compare(
    uv_px: Any,
    there: Any,
    grey: Any,
    corner: Any,
    seen: Any,
    fewest: int,
    least_spread: float,
    most_gain: float,
) -> Any:
    """By how much the brightness of a print differs from a frame's, up to a gain and an offset.

    Args:
        there: brightness of the points in the print.
        grey, corner: the frame's brightness, and the column and row of the image where it begins.
        seen: which points the frame shows.
        fewest, least_spread: fewer points, or less standard deviation of either brightness, say nothing.
        most_gain: largest gain; the smallest is its inverse.

    Returns:
        Numbers of the points that are compared, and by how much each of them differs.
    """
    rows = np.flatnonzero(seen)
    nothing = rows[:0], np.empty(0)
    if len(rows) == 0 or len(rows) < fewest:
        return nothing
    here, then = values_at(grey, uv_px[rows], corner), there[rows]
    here -= np.median(here)
    then -= np.median(then)
    if min(here.std(), then.std()) < least_spread:
        return nothing
    gain = np.median(np.abs(here)) / max(np.median(np.abs(then)), 1e-3)
    return rows, min(max(gain, 1 / most_gain), most_gain) * then - here


@compiled
def print_information(
    points: Any,
    uv_px: Any,
    rows: Any,
    difference: Any,
    right: Any,
    down: Any,
    corner: Any,
    centre: Any,
    fx: float,
    fy: float,
    scale_sigmas: float,
    least_noise: float,
) -> Any:
    """Information and pull of a print on the pose, by motions as in `fill_motion`.

    Args:
        points: in the camera frame.
        rows, difference: what `compare` returns.
        right, down: slopes of the frame's brightness, which begins at that corner of the image.
        scale_sigmas: scale of Geman-McClure's loss, in standard deviations of the differences.
        least_noise: that standard deviation is never taken to be less.

    Returns:
        Both without what the common offset of brightness, which is unknown, takes away.
    """
    information, pull, common = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    if len(rows) == 0:
        return information, pull
    motion, along = np.empty((len(rows), 2, 6)), np.empty(6)
    fill_motion(points[rows], centre, fx, fy, motion)
    noise = max(1.4826 * np.median(np.abs(difference)), least_noise)
    all_weight, all_difference = 0.0, 0.0
    for number in range(len(rows)):
        u, v = uv_px[rows[number], 0] - corner[0], uv_px[rows[number], 1] - corner[1]
        slope_u, slope_v = value_at(right, u, v), value_at(down, u, v)
        weight = 1 / (1 + (difference[number] / (scale_sigmas * noise)) ** 2) ** 2 / noise**2
        all_weight += weight
        all_difference += weight * difference[number]
        for i in range(6):
            along[i] = slope_u * motion[number, 0, i] + slope_v * motion[number, 1, i]
        for i in range(6):
            weighted = weight * along[i]
            common[i] += weighted
            pull[i] += weighted * difference[number]
            for j in range(6):
                information[i, j] += weighted * along[j]
    for i in range(6):
        pull[i] -= common[i] * all_difference / all_weight
        for j in range(6):
            information[i, j] -= common[i] * common[j] / all_weight
    return information, pull
