"""Check that a recording's numbers fit its images, before anything is computed from them."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np

from rpl_data.types import DataError, Intrinsics, Scene, spread_evenly

SATURATED = 65535
"""Value that a Kinect writes where it measured nothing; no 16-bit depth reaches it otherwise."""

USUAL_UNITS_M = (1e-3, 2e-4, 1e-4, 2.5e-4)
"""Common depth units: millimetres, TUM's 1/5000, YCB-Video's 1/10000, the RealSense L515's 1/4000 m."""


LEAST_DEPTH_M, MOST_DEPTH_M = 0.1, 10.0
"""A median depth outside has the wrong unit, whatever was recorded."""

PATTERN = 0.95
"""Share of depths that are multiples of a number from which on that is no chance."""


FEWEST_DEPTHS = 20


def share_of_multiples(units: np.ndarray, divisor: int) -> float:
    """Share of the measured depths that are multiples of a number; 1 / divisor by chance.

    0 where there are too few different depths for a pattern, as in a made-up image.
    """
    measured = units[units > 0].astype(np.int64)
    if len(np.unique(measured)) < FEWEST_DEPTHS:
        return 0.0
    return float((measured % divisor == 0).mean())


def has_turned_bits(units: np.ndarray) -> bool:
    """Whether nearly all numbers are multiples of 8, as bits turned by 3 make them, and not of 16."""
    return share_of_multiples(units, 8) > PATTERN and share_of_multiples(units, 16) <= PATTERN


def usual_units_m(units: np.ndarray) -> tuple[float, ...]:
    """Common units that these numbers may have: multiples of n (10, 5, 16, 4) are millimetres in 1/n mm."""
    for parts in (10, 5, 16, 4):
        if share_of_multiples(units, parts) > PATTERN:
            return (1e-3 / parts,)
    return USUAL_UNITS_M


def principal_point_notes(source: Path, intrinsics: Intrinsics) -> list[str]:
    """Note a principal point that is 10 % of the image off its centre; DataError at 20 %."""
    off = max(abs(intrinsics.cx / intrinsics.width - 0.5), abs(intrinsics.cy / intrinsics.height - 0.5))
    what = (
        f"{source} has its principal point at ({intrinsics.cx:.1f}, {intrinsics.cy:.1f}), but the images are "
        f"{intrinsics.width} x {intrinsics.height} px: is it for another resolution?"
    )
    if off > 0.2:
        raise DataError(
            f"{what} Write fx fy cx cy for these images into it, or give `camera: [fx, fy, cx, cy]`"
        )
    return [what] if off > 0.1 else []


def median_depth_m(scene: Scene, *, frames: int = 5) -> float:
    """Median depth of a few frames; DataError when it does not suit a hand-held recording.

    Depth that is too far because its bits are turned passes: its unit is right, and `mend:` puts it right.
    """
    picked = spread_evenly(scene.frames, frames)
    images = [cv2.imread(str(frame.depth), cv2.IMREAD_UNCHANGED) for frame in picked]
    raw = np.concatenate([np.ravel(image) for image in images if image is not None] or [np.zeros(0)])
    raw = raw[(raw > 0) & (raw < SATURATED)]
    if len(raw) == 0:
        looked_at = ", ".join(str(frame.index) for frame in picked)
        raise DataError(
            f"scene {scene.name}: the depth images of frames {looked_at} hold no depth; record it again"
        )
    median_units = float(np.median(raw))
    median_m = median_units * scene.metres_per_unit
    turned = median_m > MOST_DEPTH_M and has_turned_bits(raw)
    if not LEAST_DEPTH_M <= median_m <= MOST_DEPTH_M and not turned:
        near, now_m = median_m < LEAST_DEPTH_M, scene.metres_per_unit
        units = [u for u in usual_units_m(raw) if (u > 1.01 * now_m if near else u < 0.99 * now_m)]
        likely = min(units, key=lambda unit: abs(math.log(median_units * unit / 0.8)), default=None)
        advice = "though no usual unit puts it there" if likely is None else f"probably to {likely:g}"
        raise DataError(
            f"scene {scene.name}: with {scene.metres_per_unit:g} m per depth unit, the median depth is "
            f"{median_m:.3g} m; expected 0.1 to 10 m. Set metres_per_unit, {advice}"
        )
    return median_m
