"""Compare the pixels of a frame with a keyframe: differences of brightness and depth, and their derivatives.

Differences of depth count in standard deviations of the depth noise, which grows with the square of the
depth: 5 cm are much on a table and nothing on the far wall of a room.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from rpl_data.geometry import Transform
from rpl_data.reconstruct.information import Information
from rpl_data.reconstruct.model_map import Keyframe
from rpl_data.reconstruct.view import Pixels

AGREEING_SIGMAS = 3.0
"""Depths agree that differ by less than this many standard deviations of their difference."""

MISALIGNED_M = 0.01
"""Difference allowed beyond the noise: while the pose is still off, a pixel falls beside its own place."""

Values = Float32[np.ndarray, " n"]
Vectors = Float32[np.ndarray, "3 n"]
Value = Values | float
Derivative = Float32[np.ndarray, "6 n"]


@dataclass(frozen=True)
class Compared:
    """The pixels of a frame projected into a keyframe.

    Attributes:
        seen: the pixel projects into the keyframe's image, where that has depth.
        agrees: the pixel is seen, and its depth agrees with the keyframe's.
        smooth: the pixel agrees, and the keyframe has depth all around it.
        grey: brightness of the keyframe there.
        step: depth of the keyframe there, minus that of the pixel, per `Pixels.noise_m`.
        grey_by_uv, step_by_uv: derivatives of `grey` and `step` by u and v.
        step_by_z: derivative of `step` by the z of the pixel's point in the keyframe's frame.
        arms: from the frame's camera to the pixel's point, along the keyframe's axes.
        xy_per_z: the point's x and y in the keyframe's frame, per z.
        focal_per_z: focal lengths per z.
    """

    seen: Bool[np.ndarray, " n"]
    agrees: Bool[np.ndarray, " n"]
    smooth: Bool[np.ndarray, " n"]
    grey: Values
    step: Values
    grey_by_uv: tuple[Values, Values]
    step_by_uv: tuple[Values, Values]
    step_by_z: Values
    arms: Vectors
    xy_per_z: tuple[Values, Values]
    focal_per_z: tuple[Values, Values]

    @property
    def grey_by_motion(self) -> Derivative:
        """Derivatives of `grey` by a motion of the frame along the keyframe's axes."""
        return self.by_motion(*self.grey_by_uv)

    @property
    def step_by_motion(self) -> Derivative:
        """Derivatives of `step` by the same motion."""
        return self.by_motion(*self.step_by_uv, self.step_by_z)

    def by_motion(self, by_u: Value, by_v: Value, by_z: Value = 0.0) -> Derivative:
        """Derivatives, by a motion along the keyframe's axes, of what changes so with u, v and z.

        A motion (w, t) moves a point by ``w x arm + t``.
        """
        derivative = np.empty((6, self.arms.shape[1]), np.float32)
        (ax, ay, az), (x, y) = self.arms, self.xy_per_z
        sx, sy = by_u * self.focal_per_z[0], by_v * self.focal_per_z[1]
        sz = by_z - (sx * x + sy * y)
        derivative[0] = ay * sz - az * sy
        derivative[1] = az * sx - ax * sz
        derivative[2] = ax * sy - ay * sx
        derivative[3], derivative[4], derivative[5] = sx, sy, sz
        return derivative


def compare(
    pixels: Pixels, keyframe: Keyframe, number: int, scene_from_camera: Transform
) -> tuple[Compared, Information]:
    """Project pixels into a keyframe and compare them with it.

    Args:
        number: of the pyramid level.

    Returns:
        The comparison, and the matrix that turns a motion along the frame's axes into one along the
        keyframe's.
    """
    camera = keyframe.levels[number].camera
    keyframe_from_camera = keyframe.camera_from_scene @ scene_from_camera
    arms = keyframe_from_camera[:3, :3].astype(np.float32) @ pixels.points
    x, y, z = arms + keyframe_from_camera[:3, 3:].astype(np.float32)
    per_z = 1 / np.maximum(z, np.float32(1e-3))
    x, y = x * per_z, y * per_z
    u, v = camera.fx * x + np.float32(camera.cx), camera.fy * y + np.float32(camera.cy)
    seen = (z > 1e-3) & (u >= 1) & (u < camera.width - 2) & (v >= 1) & (v < camera.height - 2)
    u, v = np.where(seen, u, np.float32(0)), np.where(seen, v, np.float32(0))
    nearest_m = _read(keyframe.levels[number].depth_m, u, v, cv2.INTER_NEAREST)[0]
    seen &= nearest_m > 0
    agrees = seen & (np.abs(nearest_m - z) < AGREEING_SIGMAS * pixels.noise_m + np.float32(MISALIGNED_M))
    grey, grey_by_u, grey_by_v = _read(keyframe.grey[number], u, v)
    depth_m, depth_by_u, depth_by_v, whole = _read(keyframe.depth[number], u, v)
    per_noise = 1 / pixels.noise_m
    compared = Compared(
        seen,
        agrees,
        agrees & (whole > 0.999),
        grey,
        (depth_m - z) * per_noise,
        (grey_by_u, grey_by_v),
        (depth_by_u * per_noise, depth_by_v * per_noise),
        -per_noise,
        arms,
        (x, y),
        (camera.fx * per_z, camera.fy * per_z),
    )
    axes = np.zeros((6, 6))
    axes[:3, :3] = axes[3:, 3:] = keyframe_from_camera[:3, :3]
    return compared, axes


def _read(image: np.ndarray, u: Values, v: Values, how: int = cv2.INTER_LINEAR) -> np.ndarray:
    """The channels of an image at some places, one row per channel."""
    return np.ascontiguousarray(cv2.remap(image, u, v, how).reshape(len(u), -1).T)
