"""Compare the pixels of a frame with a keyframe: differences of brightness and depth, and their derivatives.

Differences of depth count in standard deviations of the depth noise, which grows with the square of the
depth: 5 cm are much on a table and nothing on the far wall of a room.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from rpl_data.geometry import Transform, invert
from rpl_data.reconstruct.information import Information
from rpl_data.reconstruct.model_map import Keyframe
from rpl_data.reconstruct.view import Pixels

AGREEING_SIGMAS = 3.0
"""Depths agree that differ by less than this many standard deviations of their difference."""

MISALIGNED_M = 0.01
"""Difference allowed beyond the noise: while the pose is still off, a pixel falls beside its own place."""

Values = Float32[np.ndarray, " n"]
Vectors = Float32[np.ndarray, "3 n"]
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
        arms: from the frame's camera to the pixel's point, along the keyframe's axes.
        grey_by_shift, step_by_shift: derivatives of `grey` and `step` by a shift of the point along the
            keyframe's axes.
        u_by_shift, v_by_shift: derivatives of the projection by the same shift.
    """

    seen: Bool[np.ndarray, " n"]
    agrees: Bool[np.ndarray, " n"]
    smooth: Bool[np.ndarray, " n"]
    grey: Values
    step: Values
    arms: Vectors
    grey_by_shift: Vectors
    step_by_shift: Vectors
    u_by_shift: Vectors
    v_by_shift: Vectors


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
    keyframe_from_camera = invert(keyframe.scene_from_camera) @ scene_from_camera
    rotation = keyframe_from_camera[:3, :3].astype(np.float32)
    arms = rotation @ pixels.points
    x, y, z = arms + keyframe_from_camera[:3, 3:].astype(np.float32)
    per_z = 1 / np.maximum(z, np.float32(1e-3))
    x_per_z, y_per_z = x * per_z, y * per_z
    u, v = np.float32(camera.fx) * x_per_z, np.float32(camera.fy) * y_per_z
    u += np.float32(camera.cx)
    v += np.float32(camera.cy)
    seen = (z > 1e-3) & (u >= 1) & (u < camera.width - 2) & (v >= 1) & (v < camera.height - 2)
    u, v = u * seen, v * seen
    nearest_m = _read(keyframe.levels[number].depth_m, u, v, cv2.INTER_NEAREST)[0]
    seen &= nearest_m > 0
    agrees = seen & (np.abs(nearest_m - z) < AGREEING_SIGMAS * pixels.noise_m + np.float32(MISALIGNED_M))
    grey, grey_by_u, grey_by_v = _read(keyframe.grey[number], u, v)
    depth_m, depth_by_u, depth_by_v, whole = _read(keyframe.depth[number], u, v)

    zero = np.zeros_like(z)
    fx_per_z, fy_per_z = np.float32(camera.fx) * per_z, np.float32(camera.fy) * per_z
    u_by = np.stack([fx_per_z, zero, -fx_per_z * x_per_z])
    v_by = np.stack([zero, fy_per_z, -fy_per_z * y_per_z])
    step_by = depth_by_u * u_by + depth_by_v * v_by
    step_by[2] -= 1
    compared = Compared(
        seen,
        agrees,
        agrees & (whole > 0.999),
        grey,
        (depth_m - z) / pixels.noise_m,
        arms,
        grey_by_u * u_by + grey_by_v * v_by,
        step_by / pixels.noise_m,
        u_by,
        v_by,
    )
    axes = np.zeros((6, 6))
    axes[:3, :3] = axes[3:, 3:] = keyframe_from_camera[:3, :3]
    return compared, axes


def _read(image: np.ndarray, u: Values, v: Values, how: int = cv2.INTER_LINEAR) -> np.ndarray:
    """The channels of an image at some places, one row per channel."""
    return cv2.remap(image, u, v, how).reshape(len(u), -1).T


def by_motion(arms: Vectors, by_shift: Vectors) -> Derivative:
    """Derivatives by a motion (w, t) of the frame, which shifts a point by ``w x arm + t``."""
    derivative = np.empty((6, arms.shape[1]), np.float32)
    (ax, ay, az), (sx, sy, sz) = arms, by_shift
    derivative[0] = ay * sz - az * sy
    derivative[1] = az * sx - ax * sz
    derivative[2] = ax * sy - ay * sx
    derivative[3:] = by_shift
    return derivative
