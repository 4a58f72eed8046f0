"""Judge which of two camera paths is right, by reprojection errors in colour and depth.

Each path predicts where the corners of one frame appear in another. In colour, the corner is found there by
optical flow (Lucas-Kanade, IJCAI 1981; forward and backward), and its distance from the prediction is the
error. In depth, the predicted depth is compared with the measured one. Neither error is what
`path_correction` minimises: that aligns whole small images.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64

from rpl_data.drift.reprojection import depth_reprojection_error_m, spread_rows
from rpl_data.geometry import (
    Pixels,
    Points,
    Transform,
    back_project,
    inside_image,
    invert,
    project,
    transform,
)
from rpl_data.types import DepthImage, Frame, GreyImage, Intrinsics, Scene, Trajectory

MOST_CORNERS, FEWEST_CORNERS = 300, 15
CORNER_DISTANCE_PX = 6
MAX_STEP = 0.04
"""Share of its depth by which the depth around a corner may vary; corners on outlines are not used."""

WINDOW_PX = 15
RETURN_PX = 0.7
"""A corner counts as found only when tracking it back ends within this distance of its start."""

HIDDEN_M = 0.05
"""A corner is hidden where the measured depth differs from its own by more than this."""

SMALLEST_PX, SMALLEST_M = 0.1, 0.0005
"""Added to the errors of both paths before they are compared, so that tiny ones do not decide."""

CLEARLY = 1.1
"""A path is clearly better when the product of its colour and depth errors is smaller by this factor."""


Region = tuple[Float64[np.ndarray, "3"], float]
"""A sphere: centre in the scene frame and radius in metres."""


@dataclass(frozen=True)
class PathErrors:
    """Reprojection errors of one path; the median over pairs of frames, NaN where nothing could be compared.

    Attributes:
        color_px: reprojection error of corners.
        depth_m: reprojection error of depth.
    """

    color_px: float
    depth_m: float

    @property
    def are_known(self) -> bool:
        """Whether anything could be compared: under a path far off, no two frames seem to show the same."""
        return bool(np.isfinite([self.color_px, self.depth_m]).any())

    def __str__(self) -> str:
        """The errors that are known, in words."""
        color = [f"{self.color_px:.1f} px in colour"] if np.isfinite(self.color_px) else []
        depth = [f"{1000 * self.depth_m:.1f} mm in depth"] if np.isfinite(self.depth_m) else []
        return " and ".join(color + depth)


def compare_paths(
    scene: Scene,
    paths: Mapping[str, Trajectory],
    read: Callable[[Frame], tuple[GreyImage, DepthImage]],
    *,
    regions: Sequence[Region] = (),
    most_frames: int = 24,
    gaps: Sequence[int] = (1, 3),
) -> dict[str, PathErrors]:
    """Measure the errors of several paths on the same pairs of frames and the same corners.

    Args:
        paths: by name.
        read: reads brightness, and depth in metres, of a frame, both at full size.
        regions: only corners inside these spheres are used, placed by the first path; empty = all corners. A
            path that fits the far wall may not fit the object: shutters roll, and distant texture constrains
            only the rotation.
        most_frames: number of frames used, evenly spread.
        gaps: frames this many places apart among them are compared.
    """
    posed = set.intersection(*(set(path.frames.tolist()) for path in paths.values()))
    frames = [frame for frame in scene.frames if frame.index in posed and frame.depth is not None]
    first = next(iter(paths.values()))
    views = []
    for row in spread_rows(len(frames), most_frames):
        grey, depth_m = read(frames[row])
        pose = invert(first.at(frames[row].index))
        spheres = [(transform(pose, centre), radius_m) for centre, radius_m in regions]
        views.append((frames[row].index, _Corners.of(scene.intrinsics, grey, depth_m, spheres)))
    color: dict[str, list[float]] = {name: [] for name in paths}
    depth: dict[str, list[float]] = {name: [] for name in paths}
    for gap in gaps:
        for (a, from_a), (b, from_b) in zip(views, views[gap:], strict=False):
            steps = {name: invert(path.at(b)) @ path.at(a) for name, path in paths.items()}
            for name, error_px in _color_errors_px(scene.intrinsics, from_a, from_b, steps).items():
                color[name].append(error_px)
            for name, b_from_a in steps.items():
                error_m = depth_reprojection_error_m(
                    scene.intrinsics, invert(b_from_a), from_a.depth_m, from_b.depth_m
                )
                depth[name].append(error_m)
    return {name: PathErrors(_median(color[name]), _median(depth[name])) for name in paths}


def is_better(a: PathErrors, b: PathErrors) -> bool:
    """Whether path a is clearly better than path b, in colour and depth together.

    A path under which nothing can be compared is worse than any other: frames that show the same do so
    wherever the camera is said to have been.
    """
    if a.are_known and not b.are_known:
        return True
    gain = 0.0
    for here, there, floor in (
        (a.color_px, b.color_px, SMALLEST_PX),
        (a.depth_m, b.depth_m, SMALLEST_M),
    ):
        if np.isfinite(here) and np.isfinite(there):
            gain += float(np.log((there + floor) / (here + floor)))
    return bool(gain > np.log(CLEARLY))


def _median(values: Sequence[float]) -> float:
    found = np.array([value for value in values if np.isfinite(value)])
    return float(np.median(found)) if len(found) else float("nan")


@dataclass(frozen=True)
class _Corners:
    """A frame with its corners: their pixels, and their points in the camera frame."""

    grey: GreyImage
    depth_m: DepthImage
    uv_px: Pixels
    points: Points

    @staticmethod
    def of(
        intrinsics: Intrinsics, grey: GreyImage, depth_m: DepthImage, spheres: Sequence[Region]
    ) -> _Corners:
        """Find the corners on smooth surfaces, inside the spheres (camera frame) when there are any."""
        nearest, farthest = (
            operation(depth_m, np.ones((5, 5), np.uint8)) for operation in (cv2.erode, cv2.dilate)
        )
        allowed = (nearest > 0) & (farthest - nearest <= MAX_STEP * depth_m)
        if spheres:
            rows, columns = np.nonzero(allowed)
            points = _lifted(intrinsics, np.column_stack([columns, rows]).astype(float), depth_m)
            near = [((points - centre) ** 2).sum(axis=1) < radius_m**2 for centre, radius_m in spheres]
            allowed[rows, columns] = np.any(near, axis=0)
        found: Any = cv2.goodFeaturesToTrack(
            grey, MOST_CORNERS, 0.005, CORNER_DISTANCE_PX, mask=allowed.astype(np.uint8)
        )
        uv_px = np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(float)
        return _Corners(grey, depth_m, uv_px, _lifted(intrinsics, uv_px, depth_m))


def _lifted(intrinsics: Intrinsics, uv_px: Pixels, depth_m: DepthImage) -> Points:
    column, row = np.rint(uv_px).astype(int).T
    return back_project(intrinsics, uv_px, depth_m[row, column].astype(float))


def _color_errors_px(
    intrinsics: Intrinsics, a: _Corners, b: _Corners, steps: Mapping[str, Transform]
) -> dict[str, float]:
    """Median distance, for each path, of the predicted corners of a from where they are found in b.

    One search starts at each path's prediction. Every path is measured on the results of all searches, so
    that none profits from starting its own.
    """
    expected = {name: project(intrinsics, transform(b_from_a, a.points)) for name, b_from_a in steps.items()}
    found = [
        (_search(a, b, _seen(intrinsics, b, transform(steps[name], a.points), uv), uv))
        for name, uv in expected.items()
    ]
    errors = {}
    for name, uv_px in expected.items():
        away = np.concatenate([np.linalg.norm(there - uv_px, axis=1) for there in found])
        away = away[np.isfinite(away)]
        errors[name] = float(np.median(away)) if len(away) >= FEWEST_CORNERS * len(steps) else float("nan")
    return errors


def _seen(intrinsics: Intrinsics, b: _Corners, points: Points, uv_px: Pixels) -> np.ndarray:
    """Which points, in the camera frame of b, lie in its image and are not hidden there."""
    seen: np.ndarray = inside_image(intrinsics, uv_px)
    column, row = np.rint(uv_px[seen]).astype(int).T
    measured = b.depth_m[row, column]
    seen[seen] = (measured == 0) | (np.abs(measured - points[seen, 2]) < HIDDEN_M)
    return seen


def _search(a: _Corners, b: _Corners, use: np.ndarray, expected_px: Pixels) -> Pixels:
    """Find the corners of a in b by optical flow; NaN for those not found."""
    found_px = np.full_like(expected_px, np.nan)
    if use.sum() < FEWEST_CORNERS:
        return found_px
    settings: dict[str, Any] = {
        "winSize": (WINDOW_PX, WINDOW_PX),
        "maxLevel": 3,
        "criteria": (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 15, 0.03),
        "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
    }
    here = np.ascontiguousarray(a.uv_px[use], dtype=np.float32).reshape(-1, 1, 2)
    guess = np.ascontiguousarray(expected_px[use], dtype=np.float32).reshape(-1, 1, 2)
    there, ok, _ = cv2.calcOpticalFlowPyrLK(a.grey, b.grey, here, guess, **settings)
    back, ok_back, _ = cv2.calcOpticalFlowPyrLK(b.grey, a.grey, there, here.copy(), **settings)
    returned = np.linalg.norm((back - here)[:, 0], axis=1) < RETURN_PX
    good = (ok.ravel() > 0) & (ok_back.ravel() > 0) & returned
    found_px[np.flatnonzero(use)[good]] = there[good, 0]
    return found_px
