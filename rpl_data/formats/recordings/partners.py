"""Pair colour and depth images that were not taken together, by their times."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int64

from rpl_data.formats.recordings.pose_lines import nearest


def partners(color_ns: Int64[np.ndarray, " n"], depth_ns: Int64[np.ndarray, " m"]) -> dict[int, int]:
    """The depth image nearest in time to each colour image, within half a frame interval, each used once."""
    if not len(color_ns) or not len(depth_ns):
        return {}
    start = int(color_ns.min())
    color_s, depth_s = (color_ns - start) * 1e-9, (depth_ns - start) * 1e-9
    order = np.argsort(depth_s, kind="stable")
    rows, apart_s = nearest(depth_s[order], color_s)
    steps = np.diff(np.unique(color_s))
    most_s = float(np.median(steps)) / 2 if len(steps) else 0.5
    used: dict[int, int] = {}
    taken: set[int] = set()
    for color in np.argsort(apart_s, kind="stable").tolist():
        depth = int(order[rows[color]])
        if apart_s[color] <= most_s and depth not in taken:
            used[color] = depth
            taken.add(depth)
    return used
