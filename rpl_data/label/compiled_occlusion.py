"""The loops of `occlusion` over pixels, in compiled code; importing this module imports numba."""

from __future__ import annotations

from typing import Any

from rpl_data.compiled import compiled
from rpl_data.geometry import depth_sigma_m

sensor_sigma_m = compiled(depth_sigma_m)


@compiled
def mark_blocked(nearest_m: Any, measured_m: Any, least_m: float, least_sigmas: float, blocked: Any) -> int:
    """Mark the pixels where measured depth lies before the object; returns how many there are."""
    count = 0
    for row in range(nearest_m.shape[0]):
        for column in range(nearest_m.shape[1]):
            model_m, sensor_m = nearest_m[row, column], measured_m[row, column]
            found = False
            if 0 < sensor_m < model_m:
                found = sensor_m < model_m - max(least_m, least_sigmas * sensor_sigma_m(model_m))
            blocked[row, column] = found
            count += found
    return count


@compiled
def count_pixels(
    model_m: Any, visible: Any, measured_m: Any, nothing_m: float, least_m: float, least_sigmas: float
) -> Any:
    """Count pixels of the object that are visible, that have a depth, and that have another than the model.

    Returns:
        These three, then pixels beside the object, and those of them that have a depth.
    """
    shown, measured, disagreeing, beside, measured_beside = 0, 0, 0, 0, 0
    for row in range(model_m.shape[0]):
        for column in range(model_m.shape[1]):
            expected_m, sensor_m = model_m[row, column], measured_m[row, column]
            if expected_m >= nothing_m:
                beside += 1
                measured_beside += sensor_m > 0
            elif visible[row, column]:
                tolerance_m = max(least_m, least_sigmas * sensor_sigma_m(expected_m))
                shown += 1
                measured += sensor_m > 0
                disagreeing += sensor_m > 0 and abs(sensor_m - expected_m) > tolerance_m
    return shown, measured, disagreeing, beside, measured_beside


@compiled
def mark_seen(
    centres: Any,
    others_from_m: Any,
    measured_from_m: Any,
    radius: int,
    others_m: Any,
    measured_m: Any,
    seen: Any,
) -> None:
    """Mark the keypoints with a pixel around them where both depths are at least so far, or none is measured.

    Args:
        centres: rows and columns in the window.
    """
    height, width = others_m.shape
    for point in range(len(centres)):
        free, behind, measured = False, False, False
        for row in range(centres[point, 0] - radius, centres[point, 0] + radius + 1):
            for column in range(centres[point, 1] - radius, centres[point, 1] + radius + 1):
                y, x = min(max(row, 0), height - 1), min(max(column, 0), width - 1)
                free |= others_m[y, x] >= others_from_m[point]
                measured |= measured_m[y, x] > 0
                behind |= measured_m[y, x] >= measured_from_m[point]
        seen[point] = free and (behind or not measured)
