"""How well the depth of one frame, moved by the poses, agrees with that of another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.geometry import (
    Points,
    Transform,
    back_project,
    inside_image,
    invert,
    project,
    transform,
)
from rpl_data.types import DepthImage, Intrinsics, ReadDepth, Scene, Trajectory, posed_frames

STEP_PX = 4
"""Every fourth pixel in both directions is used: 19,200 of an image of 640 x 480."""

LEAST_PIXELS = 500
"""Views with fewer common pixels than this overlap too little to be compared."""


@dataclass(frozen=True)
class GapErrors:
    """Depth reprojection errors of pairs of frames that are `gap` apart.

    Attributes:
        gap: difference of the `Frame.index` of a pair.
        pairs: indices (k, k + gap) of the frames.
        errors_m: for each pair, the median over its pixels of |predicted - measured depth|; NaN where the two
            views hardly overlap.
    """

    gap: int
    pairs: Int64[np.ndarray, "n 2"]
    errors_m: Float64[np.ndarray, " n"]

    @property
    def median_m(self) -> float:
        """Median over the pairs; NaN where none overlap."""
        found = self.errors_m[np.isfinite(self.errors_m)]
        return float(np.median(found)) if len(found) else float("nan")


def reprojection_over_gap(
    scene: Scene,
    trajectory: Trajectory,
    *,
    gap: int,
    read_depth: ReadDepth,
    most_pairs: int = 40,
) -> GapErrors:
    """Measure depth reprojection errors between frames `gap` apart, in constant memory.

    Args:
        gap: difference of `Frame.index`; pairs with a frame that lacks a pose or depth are left out.
        read_depth: reads the depth images of the scene.
        most_pairs: largest number of pairs, which are spread over the recording.
    """
    frames = {frame.index: frame for frame in posed_frames(scene, trajectory, with_depth=True)}
    starts = [index for index in frames if index + gap in frames]
    rows = spread_rows(len(starts), most_pairs)
    pairs = np.array([(starts[row], starts[row] + gap) for row in rows], dtype=np.int64).reshape(-1, 2)
    errors_m = [
        depth_reprojection_error_m(
            scene.intrinsics,
            invert(trajectory.at(early)) @ trajectory.at(late),
            read_depth(frames[early]),
            read_depth(frames[late]),
        )
        for early, late in pairs.tolist()
    ]
    return GapErrors(gap, pairs, np.array(errors_m, dtype=float))


def spread_rows(count: int, most: int) -> list[int]:
    """At most `most` of the numbers from 0 to count - 1, evenly spread: the frames that are compared."""
    if count < 1:
        return []
    rows: list[int] = np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int)).tolist()
    return rows


def depth_reprojection_error_m(
    intrinsics: Intrinsics, a_from_b: Transform, depth_a_m: DepthImage, depth_b_m: DepthImage
) -> float:
    """Median |z of a point of b in a - depth measured there in a|; NaN when the views hardly overlap.

    Args:
        a_from_b: takes points of camera b to camera a.
    """
    return error_of_points_m(intrinsics, a_from_b, depth_a_m, sampled_points(intrinsics, depth_b_m))


def sampled_points(intrinsics: Intrinsics, depth_m: DepthImage) -> Points:
    """The points that every `STEP_PX`-th pixel sees, camera frame; for images compared with many others."""
    rows, columns = np.mgrid[0 : intrinsics.height : STEP_PX, 0 : intrinsics.width : STEP_PX]
    measured = depth_m[rows, columns] > 0
    uv_px = np.column_stack([columns[measured], rows[measured]]).astype(float)
    return back_project(intrinsics, uv_px, depth_m[rows[measured], columns[measured]].astype(float))


def error_of_points_m(
    intrinsics: Intrinsics, a_from_b: Transform, depth_a_m: DepthImage, points_b: Points
) -> float:
    """`depth_reprojection_error_m` of what `sampled_points` made of b."""
    points_a = transform(a_from_b, points_b)
    uv_a_px = project(intrinsics, points_a)  # NaN behind the camera
    inside = inside_image(intrinsics, uv_a_px)
    u, v = np.rint(uv_a_px[inside]).astype(int).T
    seen_m = depth_a_m[v, u]
    differences_m = np.abs(points_a[inside, 2] - seen_m)[seen_m > 0]
    return float(np.median(differences_m)) if len(differences_m) >= LEAST_PIXELS else float("nan")
