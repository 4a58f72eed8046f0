"""The view of a frame that tracking uses: small images of brightness and depth, and a thinned point cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32

from rpl_data.geometry import Points, depth_sigma_m, rays, resized
from rpl_data.types import DepthImage, GreyImage, Intrinsics

REDUCE = 2
"""Tracking works on images of half the size."""

LEVELS = 3
"""Pyramid levels per view: 320 x 240, 160 x 120 and 80 x 60 of a 640 x 480 recording."""

SPACING_M = 0.03
"""The point cloud is thinned to one point per cube with this edge."""

NEIGHBOURS = 10
"""Points that a normal of the cloud is fitted to."""

CLOUD_NOISE_M = 0.04
"""Points with a larger standard deviation of depth are left out of the cloud: at 3.6 m and beyond."""

STEEP_PIXELS = 2000
EVEN_PIXELS = 600
"""Pixels compared per level: at most this many where brightness changes steeply, and this many elsewhere."""

SMALL_PX = 80
"""Width of a small image."""

JUMP, JUMP_SIGMAS = 0.02, 3.0
"""Depth jumps where it changes by more than this share of itself and more than this many standard deviations
of its noise."""

DEPTH_STEP_M = 0.0005
"""Standard deviation of depth that is stored in whole millimetres, and somewhat more."""

Image = Float32[np.ndarray, "rows columns"]


@dataclass(frozen=True)
class Pixels:
    """Some pixels of an image.

    Attributes:
        points: their points in the camera frame, one column per pixel.
        grey: their brightness.
        noise_m: standard deviation of the difference of two measurements of their depth.
    """

    points: Float32[np.ndarray, "3 n"]
    grey: Float32[np.ndarray, " n"]
    noise_m: Float32[np.ndarray, " n"]


@dataclass(frozen=True)
class Level:
    """One pyramid level of a view.

    Attributes:
        camera: intrinsics at this size, without lens distortion.
        grey: brightness, 0 to 255.
        depth_m: 0 where depth is missing or jumps.
    """

    camera: Intrinsics
    grey: Image
    depth_m: Image

    @cached_property
    def pixels(self) -> Pixels:
        """The pixels that are compared with keyframes."""
        return _chosen_pixels(self)


@dataclass(frozen=True)
class View:
    """A frame as tracking sees it.

    Attributes:
        levels: the pyramid, largest level first.
        points: points of the last level, those measured to better than `CLOUD_NOISE_M`; camera frame.
    """

    levels: tuple[Level, ...]
    points: Points

    @cached_property
    def cloud(self) -> Any:
        """Thinned points with normals and covariances (`small_gicp.PointCloud`), camera frame."""
        import small_gicp

        if len(self.points) < NEIGHBOURS:
            return small_gicp.PointCloud(self.points)
        cloud, _ = small_gicp.preprocess_points(
            self.points, downsampling_resolution=SPACING_M, num_neighbors=NEIGHBOURS
        )
        return cloud


class Viewer:
    """Make views of a camera's frames; what depends on the camera alone is computed once."""

    def __init__(self, intrinsics: Intrinsics) -> None:
        small = resized(intrinsics, width=intrinsics.width // REDUCE, height=intrinsics.height // REDUCE)
        self._undistort = _maps(small) if any(small.distortion) else None
        self._cameras = _halvings(replace(small, distortion=()))
        camera = self._cameras[-1]
        v, u = np.mgrid[0 : camera.height, 0 : camera.width]
        directions = rays(camera, np.column_stack([u.ravel(), v.ravel()]).astype(float))
        self._directions = directions.reshape(camera.height, camera.width, 3)

    def look(self, grey: GreyImage, depth_m: DepthImage) -> View:
        """Make the view of a frame.

        Args:
            grey: brightness at `1 / REDUCE` of the size.
            depth_m: depth at full size.
        """
        bright: Any = grey.astype(np.float32)
        depth: Any = halved_depth(depth_m)
        if self._undistort is not None:
            bright = cv2.remap(bright, self._undistort[0], self._undistort[1], cv2.INTER_LINEAR)
            depth = cv2.remap(depth, self._undistort[0], self._undistort[1], cv2.INTER_NEAREST)
        levels = [Level(self._cameras[0], bright, depth)]
        for camera in self._cameras[1:]:
            # Not pyrDown, whose pixels lie on every second pixel and not between two as `resized` says.
            size = (camera.width, camera.height)
            bright = cv2.resize(levels[-1].grey, size, interpolation=cv2.INTER_AREA)
            levels.append(Level(camera, bright, halved_depth(levels[-1].depth_m)))
        depth = levels[-1].depth_m
        seen = (depth > 0) & (depth_sigma_m(depth) < CLOUD_NOISE_M)
        return View(tuple(levels), self._directions[seen] * depth[seen, None])


def _chosen_pixels(level: Level) -> Pixels:
    """Choose pixels where brightness is steep, and some others: a few edges may constrain one side only."""
    step = 2 if level.camera.width > SMALL_PX else 1  # of a large image, every other row and column do
    depth_m, grey = level.depth_m[1:-1:step, 1:-1:step], level.grey
    steep = np.abs(grey[1:-1:step, 2::step] - grey[1:-1:step, :-2:step])
    steep += np.abs(grey[2::step, 1:-1:step] - grey[:-2:step, 1:-1:step])
    measured = np.flatnonzero(depth_m)
    slopes = steep.ravel()[measured]
    sample = slopes[::7]
    threshold = np.partition(sample, len(sample) // 2)[len(sample) // 2] if len(sample) else 0.0
    chosen = np.concatenate(
        [
            _thinned(measured[slopes > threshold], STEEP_PIXELS),
            _thinned(measured[slopes <= threshold], EVEN_PIXELS),
        ]
    )
    rows, columns = (1 + step * number for number in np.divmod(chosen, depth_m.shape[1]))
    camera, depth_m = level.camera, level.depth_m[rows, columns]
    x = (columns - camera.cx) / camera.fx * depth_m
    y = (rows - camera.cy) / camera.fy * depth_m
    noise_m = np.sqrt(2) * np.hypot(depth_sigma_m(depth_m), DEPTH_STEP_M)
    return Pixels(
        np.stack([x, y, depth_m]).astype(np.float32), level.grey[rows, columns], noise_m.astype(np.float32)
    )


def _thinned(numbers: np.ndarray, count: int) -> np.ndarray:
    return numbers[:: max(1, -(-len(numbers) // count))]


def halved_depth(depth_m: DepthImage) -> Image:
    """Halve a depth image: the mean of four pixels, 0 unless all four have depth and lie on one surface."""
    height, width = depth_m.shape[0] // 2, depth_m.shape[1] // 2
    even = depth_m[: 2 * height, : 2 * width]
    mean = cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA)
    nearest = cv2.erode(even, np.ones((2, 2), np.uint8), anchor=(0, 0))[::2, ::2]
    allowed_m = np.maximum(JUMP * mean, JUMP_SIGMAS * depth_sigma_m(mean))
    mean[(mean - nearest > allowed_m) | (nearest == 0)] = 0
    return mean


def _halvings(camera: Intrinsics) -> tuple[Intrinsics, ...]:
    """The intrinsics at every level."""
    cameras = [camera]
    for _ in range(LEVELS - 1):
        last = cameras[-1]
        cameras.append(resized(last, width=last.width // 2, height=last.height // 2))
    return tuple(cameras)


def _maps(camera: Intrinsics) -> Sequence[Any]:
    return cv2.initUndistortRectifyMap(
        camera.matrix,
        np.array(camera.distortion),
        None,
        camera.matrix,
        (camera.width, camera.height),
        cv2.CV_32FC1,
    )
