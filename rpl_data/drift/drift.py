"""Measure how far the poses of a scene drift over time, and where to cut it so that no part drifts too far.

Labels carry one `scene_from_object` through a whole scene (Eq. 3), so they are wrong by the drift of the
poses since the clicked frames. Depth images measure it: the depth of some frames, evenly spread, is
reprojected into one another by their poses. The error beyond that between neighbouring frames, which is
noise, is drift. Only motion that changes depth is measured, about a third to a half of a drift in any
direction, and nothing of a slide along a table. Where a corrected path is known
(`reconstruct.path_correction`, which uses brightness, too), the larger of the two measurements counts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.drift.reprojection import error_of_points_m, sampled_points, spread_rows
from rpl_data.geometry import (
    Transform,
    invert,
    rotation_angle_rad,
    transform,
)
from rpl_data.types import Frame, ReadDepth, Scene, Span, Trajectory, posed_frames

MAX_DRIFT_MM = 15.0
"""Recordings that drift farther are cut, unless the recipe sets another limit."""

SAME_SIDE_RAD = 0.87
"""Views turned farther apart than this (50 degrees) are not compared: they see other sides of things."""

FEWEST_NEIGHBOURS = 4
"""In a sparse recording the limit rises to this many times the usual turn between the compared frames."""

FEWEST_PAIRS = 3
"""Fewest pairs whose median is taken: a single pair may be wrong by occlusion."""


@dataclass(frozen=True)
class Drift:
    """The drift of the poses between some frames of a scene.

    Attributes:
        frames: `Frame.index` of the measured frames, in order.
        between_m: drift between each two of them, beyond the noise; NaN where their views hardly overlap.
        noise_m: depth reprojection error between neighbouring frames of the recording.
    """

    frames: Int64[np.ndarray, " n"]
    between_m: Float64[np.ndarray, "n n"]
    noise_m: float

    def of_stretch(self, first: int, behind: int) -> float:
        """Drift in metres over the measured frames in rows first to behind - 1.

        Pairs of frames are grouped by how far apart they are, with about as many pairs per group as there are
        frames. The drift is the largest median of a group.
        """
        return max((float(np.median(group)) for group in self._groups(first, behind)), default=0.0)

    def sure_beyond(self, limit_m: float, *, resamples: int = 200) -> float:
        """Share of bootstrap resamples of the pairs in which the drift of the whole scene exceeds a limit."""
        groups = self._groups(0, len(self.frames))
        if not groups:
            return 0.0
        widest = max(groups, key=np.median)
        chosen = np.random.default_rng(0).choice(widest, (resamples, len(widest)))
        return float((np.median(chosen, axis=1) > limit_m).mean())

    def _groups(self, first: int, behind: int) -> list[Float64[np.ndarray, " pairs"]]:
        """Drift of the pairs of frames, grouped by how far apart they are."""
        count = behind - first
        i, j = np.triu_indices(count, 1)
        between = self.between_m[first:behind, first:behind][i, j]
        seen = np.isfinite(between)
        farthest_first = between[seen][np.argsort(i[seen] - j[seen], kind="stable")]
        groups = np.array_split(farthest_first, max(1, len(farthest_first) // max(FEWEST_PAIRS, count)))
        return [group for group in groups if len(group)]

    @property
    def whole_m(self) -> float:
        """Drift over the whole scene."""
        return self.of_stretch(0, len(self.frames))


def measure_drift(
    scene: Scene,
    trajectory: Trajectory,
    read_depth: ReadDepth,
    *,
    corrected: Trajectory | None = None,
    most_frames: int = 24,
    most_neighbours: int = 8,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> Drift:
    """Measure drift by comparing `most_frames` depth images pairwise, and some with their neighbours.

    Args:
        read_depth: reads the depth images of the scene.
        corrected: the path corrected by the images; it also shows drift between views of different sides,
            and along a table.
        advance: called with the number of images read and of all images.
    """
    frames = posed_frames(scene, trajectory, with_depth=True)
    rows = spread_rows(len(frames), most_frames)
    beside = spread_rows(len(frames) - 1, most_neighbours)
    wanted = sorted({*rows, *beside, *(row + 1 for row in beside)})
    depths_m, points, middles = {}, {}, {}
    for number, row in enumerate(wanted):
        advance(number, len(wanted))
        depths_m[row] = read_depth(frames[row])
        points[row] = sampled_points(scene.intrinsics, depths_m[row])
        middles[row] = np.array([0.0, 0.0, float(np.median(points[row][:, 2])) if len(points[row]) else 0.0])

    turns_rad = [_turn_rad(trajectory, frames[a], frames[b]) for a, b in pairwise(rows)]
    widest_rad = max(SAME_SIDE_RAD, FEWEST_NEIGHBOURS * float(np.median(turns_rad))) if turns_rad else np.pi

    def error_m(a: int, b: int) -> float:
        if _turn_rad(trajectory, frames[a], frames[b]) > widest_rad:
            return float("nan")
        a_from_b = _between(trajectory, frames[a], frames[b])
        return error_of_points_m(scene.intrinsics, a_from_b, depths_m[a], points[b])

    known = set() if corrected is None else set(corrected.frames.tolist())

    def moved_m(a: int, b: int) -> float:
        """Distance, seen from frame a, by which the correction moves the middle of what frame b sees."""
        if corrected is None or not {frames[a].index, frames[b].index} <= known:
            return float("nan")
        here, there = (
            transform(_between(path, frames[a], frames[b]), middles[b]) for path in (trajectory, corrected)
        )
        return float(np.linalg.norm(here - there))

    neighbours = np.array([error_m(row, row + 1) for row in beside], dtype=float)
    noise_m = float(np.median(neighbours[np.isfinite(neighbours)])) if np.isfinite(neighbours).any() else 0.0
    between_m = np.zeros((len(rows), len(rows)))
    for i, j in zip(*np.triu_indices(len(rows), 1), strict=True):
        excess = np.sqrt(np.maximum(error_m(rows[i], rows[j]) ** 2 - noise_m**2, 0.0))
        between_m[i, j] = between_m[j, i] = np.fmax(excess, moved_m(rows[i], rows[j]))
    indices = np.array([frames[row].index for row in rows], dtype=np.int64)
    return Drift(indices, between_m, noise_m)


def _between(path: Trajectory, a: Frame, b: Frame) -> Transform:
    """`a_from_b` of two frames."""
    a_from_b: Transform = invert(path.at(a.index)) @ path.at(b.index)
    return a_from_b


def _turn_rad(path: Trajectory, a: Frame, b: Frame) -> float:
    """Angle by which the camera turned between two frames."""
    return rotation_angle_rad(_between(path, a, b)[:3, :3])


def cut(
    drift: Drift,
    *,
    max_drift_m: float,
    most_parts: int = 6,
    allowed: Callable[[int, int], bool] = lambda first, last: True,
) -> list[Span] | None:
    """Cut a scene into the fewest parts within the limit, with the least drift in the worst of them.

    Args:
        allowed: whether frames first to last may form a part.

    Returns:
        First and last frame (`Frame.index`) of every part; together they cover all frames. A single part when
        the scene need not be cut, an empty list without frames, None when `most_parts` parts are too few.
    """
    count = len(drift.frames)
    if count == 0:
        return []
    strayed_m = {
        (a, b): drift.of_stretch(a, b) if allowed(*_span(drift.frames, a, b)) else np.inf
        for a in range(count)
        for b in range(a + 1, count + 1)
    }
    # For the first b rows: the drift of the worst part of their best cut, and where its parts begin.
    best: dict[int, tuple[float, tuple[int, ...]]] = {
        b: (drift.of_stretch(0, b) if b == count else strayed_m[0, b], (0,)) for b in range(1, count + 1)
    }
    for parts in range(1, most_parts + 1):
        if count not in best:
            break
        if best[count][0] <= max_drift_m:
            begins = (*best[count][1], count)
            return [_span(drift.frames, a, b) for a, b in pairwise(begins)]
        best = {
            b: min((max(best[a][0], strayed_m[a, b]), (*best[a][1], a)) for a in range(parts, b))
            for b in range(parts + 1, count + 1)
        }
    return None


def _span(frames: Int64[np.ndarray, " n"], a: int, b: int) -> Span:
    """Frames of the part with rows a to b - 1; a cut lies midway between two measured frames."""
    first = int(frames[0]) if a == 0 else int(frames[a - 1] + frames[a]) // 2 + 1
    last = int(frames[-1]) if b == len(frames) else int(frames[b - 1] + frames[b]) // 2
    return first, last


def drift_to_json(drift: Drift) -> dict[str, Any]:
    """Convert to JSON-ready values; null where views hardly overlap."""
    between = [[None if np.isnan(m) else round(float(m), 6) for m in row] for row in drift.between_m]
    return {"frames": drift.frames.tolist(), "between_m": between, "noise_m": drift.noise_m}


def drift_from_json(data: dict[str, Any]) -> Drift:
    """Read the drift from what `drift_to_json` made."""
    between_m = np.array(data["between_m"], dtype=float).reshape(2 * (len(data["frames"]),))
    return Drift(np.array(data["frames"], dtype=np.int64), between_m, data["noise_m"])
