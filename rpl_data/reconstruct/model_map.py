"""The map that frames are aligned to: keyframes with their images, and Gaussians of all their depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32

from rpl_data.geometry import Transform, depth_sigma_m, invert
from rpl_data.reconstruct.information import (
    INDEPENDENT,
    Estimate,
    Information,
    above_noise,
    distances_m,
)
from rpl_data.reconstruct.relocalise import Landmarks, landmarks_of
from rpl_data.reconstruct.view import Image, Level, View

VOXEL_M = 0.04
"""Edge of a voxel; each voxel holds one Gaussian. Of all sizes tried, 2 to 4 cm were best."""

NORMALS_RAD = 0.15
"""Standard deviation of a point's normal, which is fitted to the noisy depth of its neighbours."""

LEAST_INLIERS = 100
"""Fewer points than this say nothing about the pose."""

BIAS = 0.02
"""Voxels blur edges, so errors of many points are correlated: the map's information is scaled by this."""

Bright = Float32[np.ndarray, "_ _ 3"]
"""Brightness, and its change per pixel in u and in v."""

Deep = Float32[np.ndarray, "_ _ 4"]
"""Depth in metres, its change per pixel in u and in v, and 1 where all depth around belongs to one
surface."""

STEEPEST, STEEPEST_SIGMAS = 0.1, 6.0
"""Depths in a window of 5 x 5 pixels belong to one surface when they differ by less than this share of the
nearest, or by less than this many standard deviations of its noise. A slope over an edge means nothing."""


@dataclass(frozen=True)
class Keyframe:
    """A frame that other frames are aligned to.

    Attributes:
        index: `Frame.index`.
        levels: its images, largest first.
        grey, depth: for each level, brightness and depth with their derivatives.
        landmarks: corners by which the camera is relocalised after the track was lost.
    """

    index: int
    scene_from_camera: Transform
    levels: tuple[Level, ...]
    grey: tuple[Bright, ...]
    depth: tuple[Deep, ...]
    landmarks: Landmarks

    @cached_property
    def camera_from_scene(self) -> Transform:
        """Inverse of its pose."""
        return invert(self.scene_from_camera)


def keyframe_of(index: int, view: View, scene_from_camera: Transform) -> Keyframe:
    """Make a keyframe of a frame's view and pose."""
    return Keyframe(
        index,
        scene_from_camera,
        view.levels,
        tuple(np.dstack([level.grey, *_slopes(level.grey)]) for level in view.levels),
        tuple(_deep(level) for level in view.levels),
        landmarks_of(view.levels[0]),
    )


class ModelMap:
    """Keyframes, and Gaussians in voxels for VGICP (Koide et al., ICRA 2021).

    Its memory grows with the space that the camera sees and the directions it sees it from, not with the
    length of the recording.
    """

    def __init__(self) -> None:
        import small_gicp

        self._gaussians = small_gicp.GaussianVoxelMap(VOXEL_M)
        self._gaussians.set_lru(horizon=1_000_000, clear_cycle=1_000)  # forget nothing
        self.keyframes: list[Keyframe] = []

    def add(self, index: int, view: View, scene_from_camera: Transform) -> Keyframe:
        """Add a frame as a keyframe."""
        self._gaussians.insert(view.cloud, scene_from_camera)
        self.keyframes.append(keyframe_of(index, view, scene_from_camera))
        return self.keyframes[-1]

    def by_distance(self, scene_from_camera: Transform) -> Sequence[tuple[float, Keyframe]]:
        """The keyframes, most similar view first, each with its distance from this pose (`size_m`)."""
        poses = np.array([keyframe.scene_from_camera for keyframe in self.keyframes])
        found_m = distances_m(poses, scene_from_camera)
        return [(float(found_m[row]), self.keyframes[row]) for row in np.argsort(found_m)]

    def align(self, view: View, guess: Transform) -> Estimate:
        """Fit a frame's points to the Gaussians of all keyframes, starting at a guess of its pose.

        Where too few points meet any Gaussian, the guess comes back with no information.
        """
        import small_gicp

        if view.cloud.size() < LEAST_INLIERS:
            return Estimate(guess, np.zeros((6, 6)))
        found = small_gicp.align(
            self._gaussians,
            view.cloud,
            init_T_target_source=guess,
            max_correspondence_distance=3 * VOXEL_M,
            max_iterations=15,
            rotation_epsilon=5e-4,
            translation_epsilon=3e-4,
        )
        if found.num_inliers < LEAST_INLIERS or not np.isfinite(found.T_target_source).all():
            return Estimate(guess, np.zeros((6, 6)))
        return Estimate(found.T_target_source, _information(view, found))


def _information(view: View, found: Any) -> Information:
    """Information matrix of the point-to-plane distances, which leaves sliding along a plane free.

    small_gicp's own Hessian also pulls points to the middle of their voxels, so it would claim to know such
    sliding. The noise of the normals would claim it too: the information that noise alone gives is
    subtracted.
    """
    points, normals = view.cloud.points()[:, :3], view.cloud.normals()[:, :3]
    noise = np.zeros((6, 6))
    for axis in np.eye(3):
        noise += NORMALS_RAD**2 * _outer(points, np.broadcast_to(axis, points.shape))
    known = above_noise(_outer(points, normals), noise)
    # A Gaussian is 1e-3 m^2 thick, the sum of the point's and the voxel's 2e-3; half of r^2 / 2e-3 is the
    # error of small_gicp.
    variance_m2 = max(4e-3 * found.error / max(found.num_inliers, 1), 1e-7)
    share = found.num_inliers / max(len(points), 1)
    information: Information = known * (share * BIAS * INDEPENDENT / variance_m2)
    return information


def _outer(points: Any, directions: Any) -> Information:
    """Sum of J^T J, where J is the derivative of ``directions . points`` by the motion."""
    derivative = np.hstack([np.cross(points, directions), directions])
    product: Information = derivative.T @ derivative
    return product


def _deep(level: Level) -> Deep:
    window = np.ones((5, 5), np.uint8)
    nearest, farthest = cv2.erode(level.depth_m, window), cv2.dilate(level.depth_m, window)
    allowed_m = np.maximum(STEEPEST * nearest, STEEPEST_SIGMAS * depth_sigma_m(nearest))
    whole = (nearest > 0) & (farthest - nearest < allowed_m)
    slopes = [np.where(whole, slope, np.float32(0)) for slope in _slopes(cv2.blur(level.depth_m, (3, 3)))]
    return np.dstack([level.depth_m, *slopes, whole.astype(np.float32)])


def _slopes(image: Image) -> Sequence[Any]:
    return [cv2.Scharr(image, cv2.CV_32F, *axes, scale=1 / 32) for axes in ((1, 0), (0, 1))]
