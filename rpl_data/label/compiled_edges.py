"""The loops of `outline` over points of an outline, in compiled code; importing this module imports numba."""

from __future__ import annotations

from typing import Any

import numpy as np

from rpl_data.compiled import compiled


@compiled
def spread_over(points: Any, usable: Any, most: int, across: Any, down: Any, depth_m: Any) -> Any:
    """Points spread evenly over those that are usable, with unit normals against the slope, and depths.

    Args:
        across, down: the slope of a picture of the object, per column and row.

    Returns:
        A row per point: its column and row, its normal, and the depth there.
    """
    kept = np.empty((len(points), 2), np.int64)
    count = 0
    for point in range(len(points)):
        column, row = points[point, 0], points[point, 1]
        if usable[row, column]:
            kept[count, 0], kept[count, 1] = column, row
            count += 1
    step = max(1, -(-count // most))
    spread = np.empty((count, 5))
    size = 0
    for point in range(0, count, step):
        column, row = kept[point, 0], kept[point, 1]
        to_u, to_v = -np.float64(across[row, column]), -np.float64(down[row, column])
        length = np.sqrt(to_u**2 + to_v**2)
        if length > 0:
            spread[size, 0], spread[size, 1] = column, row
            spread[size, 2], spread[size, 3] = to_u / length, to_v / length
            spread[size, 4] = depth_m[row, column]
            size += 1
    return spread[:size]


@compiled
def mark_cuts(
    uv_px: Any,
    normal: Any,
    expected_m: Any,
    tolerance_m: Any,
    depth_m: Any,
    reach: int,
    fewest: int,
    most_wrong: int,
    found: Any,
    offset_px: Any,
) -> None:
    """Where along each normal of an outline depth passes from the object to what lies behind it."""
    height, width = depth_m.shape
    sides = np.empty(2 * reach + 1, np.int64)
    for point in range(len(uv_px)):
        inside, here, behind = True, 0, 0
        for step in range(len(sides)):
            u = np.rint(uv_px[point, 0] + normal[point, 0] * (step - reach))
            v = np.rint(uv_px[point, 1] + normal[point, 1] * (step - reach))
            if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
                inside = False
                break
            sensor_m = depth_m[int(v), int(u)]
            beyond_m = sensor_m - expected_m[point]
            is_behind = sensor_m > 0 and beyond_m > tolerance_m[point]
            is_here = sensor_m > 0 and abs(beyond_m) <= tolerance_m[point]
            here, behind = here + is_here, behind + is_behind
            sides[step] = int(is_behind) - int(is_here)
        if not inside or here < fewest or behind < fewest:
            continue
        # A cut before a step has on its wrong side what lies behind within, and what is here without.
        wrong, least, cut = here, here, 0
        for step in range(len(sides)):
            wrong += sides[step]
            if wrong < least:
                least, cut = wrong, step + 1
        if least <= most_wrong:
            # The outline's points are the last pixels of the object, half a pixel within its edge.
            found[point], offset_px[point] = True, cut - 1.0 - reach


@compiled
def fill_motion(points: Any, centre: Any, fx: float, fy: float, motion: Any) -> None:
    """Derivatives of projections by a turn about the centre, point x axis, and by a shift."""
    for point in range(len(points)):
        x, y, z = points[point, 0], points[point, 1], points[point, 2]
        from_x, from_y, from_z = x - centre[0], y - centre[1], z - centre[2]
        for axis in range(2):
            along_x = fx / z if axis == 0 else 0.0
            along_y = fy / z if axis == 1 else 0.0
            along_z = -fx * x / z**2 if axis == 0 else -fy * y / z**2
            row = motion[point, axis]
            row[0] = from_y * along_z - from_z * along_y
            row[1] = from_z * along_x - from_x * along_z
            row[2] = from_x * along_y - from_y * along_x
            row[3], row[4], row[5] = along_x, along_y, along_z


@compiled
def motion_along(
    uv_px: Any, normal: Any, depth_m: Any, directions: Any, centre: Any, fx: float, fy: float
) -> Any:
    """How far points of an outline move along their normals, by motions as in `fill_motion`.

    Args:
        directions: of the rays through all pixels of the image.
    """
    count = len(uv_px)
    points, motion, along = np.empty((count, 3)), np.empty((count, 2, 6)), np.empty((count, 6))
    for point in range(count):
        direction = directions[int(uv_px[point, 1]), int(uv_px[point, 0])]
        for axis in range(3):
            points[point, axis] = direction[axis] * depth_m[point]
    fill_motion(points, centre, fx, fy, motion)
    for point in range(count):
        for axis in range(6):
            along[point, axis] = (
                normal[point, 0] * motion[point, 0, axis] + normal[point, 1] * motion[point, 1, axis]
            )
    return along


@compiled
def add_equations(
    along: Any,
    found: Any,
    offset_px: Any,
    sigma_px: float,
    bias_px: float,
    scale_sigmas: float,
    information: Any,
    pull: Any,
) -> None:
    """Add information and pull of edges on the pose.

    What their offsets have in common, of that standard deviation, is eliminated; nothing where it is 0.
    """
    middle = _median_of(offset_px, found) / sigma_px if bias_px > 0 else 0.0
    common, all_weight, all_offset = np.zeros(6), 0.0, 0.0
    for edge in range(len(found)):
        if not found[edge]:
            continue
        offset = offset_px[edge] / sigma_px
        weight = 1 / (1 + ((offset - middle) / scale_sigmas) ** 2) ** 2
        all_weight += weight
        all_offset += weight * offset
        for i in range(6):
            weighted = weight * along[edge, i] / sigma_px
            common[i] += weighted
            pull[i] += weighted * offset
            for j in range(6):
                information[i, j] += weighted * along[edge, j] / sigma_px
    if bias_px > 0:
        share = 1 / (all_weight + (sigma_px / bias_px) ** 2)
        for i in range(6):
            pull[i] -= share * common[i] * all_offset
            for j in range(6):
                information[i, j] -= share * common[i] * common[j]


@compiled
def _median_of(values: Any, chosen: Any) -> Any:
    """Median of the chosen values, at least one of them; few, so they are sorted by insertion."""
    ordered, count = np.empty(len(values)), 0
    for row in range(len(values)):
        if chosen[row]:
            at = count
            while at > 0 and ordered[at - 1] > values[row]:
                ordered[at] = ordered[at - 1]
                at -= 1
            ordered[at] = values[row]
            count += 1
    return (ordered[(count - 1) // 2] + ordered[count // 2]) / 2
