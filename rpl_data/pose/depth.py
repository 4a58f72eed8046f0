"""Read the measured depth at keypoints."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from rpl_data.types import DepthImage


def depths_at(
    depth: DepthImage, keypoints_px: Float64[np.ndarray, "k 2"], *, radius_px: int = 2, layer_m: float = 0.02
) -> Float64[np.ndarray, " k"]:
    """Depth of the nearest surface around each keypoint, metres; NaN where nothing was measured.

    Keypoints lie on corners and edges, where half of the surrounding pixels show what is behind. So it is the
    median of the pixels within `layer_m` of the nearest depth, of which there must be at least three.
    """
    height, width = depth.shape
    found = np.full(len(keypoints_px), np.nan)
    for row, (u, v) in enumerate(keypoints_px):
        if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):  # NaN counts as outside
            continue
        column, line = round(u), round(v)
        top, left = max(line - radius_px, 0), max(column - radius_px, 0)
        window = depth[top : line + radius_px + 1, left : column + radius_px + 1]
        measured = np.sort(window[window > 0]).astype(float)
        if len(measured) < 3:
            continue
        layer = measured[measured <= measured[2] + layer_m]  # up to two nearer pixels may be noise
        found[row] = float(np.median(layer))
    return found
