"""The view of a frame that tracking uses: small images of brightness and depth, and a thinned point cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32

from rpl_data.geometry import Points, rays, resized
from rpl_data.types import DepthImage, GreyImage, Intrinsics

REDUCE = 2
"""Tracking works on images of half the size."""

LEVELS = 3
"""Pyramid levels per view: 320 x 240, 160 x 120 and 80 x 60 of a 640 x 480 recording."""

SPACING_M = 0.03
"""The point cloud is thinned to one point per cube with this edge."""

Image = Float32[np.ndarray, "rows columns"]


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


@dataclass(frozen=True)
class View:
    """A frame as tracking sees it.

    Attributes:
        levels: the pyramid, largest level first.
        points: points of the second level, in the camera frame.
    """

    levels: tuple[Level, ...]
    points: Points

    @cached_property
    def cloud(self) -> Any:
        """Thinned points with normals and covariances (`small_gicp.PointCloud`), camera frame."""
        import small_gicp

        cloud, _ = small_gicp.preprocess_points(self.points, downsampling_resolution=SPACING_M)
        return cloud


class Viewer:
    """Make views of a camera's frames; what depends on the camera alone is computed once."""

    def __init__(self, intrinsics: Intrinsics) -> None:
        small = resized(intrinsics, width=intrinsics.width // REDUCE, height=intrinsics.height // REDUCE)
        self._undistort = _maps(small) if any(small.distortion) else None
        self._cameras = _halvings(replace(small, distortion=()))
        camera = self._cameras[1]
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
        seen = levels[1].depth_m > 0
        return View(tuple(levels), self._directions[seen] * levels[1].depth_m[seen, None])


def halved_depth(depth_m: DepthImage, *, max_step: float = 0.02) -> Image:
    """Halve a depth image: the mean of four pixels, 0 unless all four have depth and lie on one surface.

    Args:
        max_step: share of the depth by which the nearest of the four may lie in front of the mean.
    """
    height, width = depth_m.shape[0] // 2, depth_m.shape[1] // 2
    even = depth_m[: 2 * height, : 2 * width]
    mean = cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA)
    rows = np.minimum(even[::2], even[1::2])
    nearest = np.minimum(rows[:, ::2], rows[:, 1::2])
    mean[mean - nearest > max_step * mean] = 0  # a missing pixel is 0, far before the mean, too
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
