"""Compare the pixels of a frame with a keyframe: residuals of brightness and depth, and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from rpl_data.geometry import Transform, invert
from rpl_data.reconstruct.information import Information
from rpl_data.reconstruct.model_map import Keyframe
from rpl_data.reconstruct.view import Level

STEEP_PIXELS = 2000
EVEN_PIXELS = 600
"""Pixels compared per level: about this many where brightness changes steeply, and this many elsewhere."""

Values = Float32[np.ndarray, " n"]
Derivative = Float32[np.ndarray, "6 n"]


@dataclass(frozen=True)
class Pixels:
    """Pixels of a frame: their points in its camera frame, one column per pixel, and their brightness."""

    points: Float32[np.ndarray, "3 n"]
    grey: Values


@dataclass(frozen=True)
class Compared:
    """The pixels of a frame projected into a keyframe.

    Attributes:
        seen: the pixel projects into the keyframe's image, where that has depth.
        agrees: the pixel is seen, and its depth differs from the keyframe's by less than 2 % and 5 mm.
        smooth: the pixel agrees, and the keyframe has depth all around it.
        grey: brightness of the keyframe there.
        step_m: depth of the keyframe there, minus that of the pixel.
        u_by_motion, v_by_motion: derivatives of the projection by a motion of the frame along the keyframe's
            axes.
        grey_by_motion, step_by_motion: derivatives of `grey` and `step_m` by the same motion.
    """

    seen: Bool[np.ndarray, " n"]
    agrees: Bool[np.ndarray, " n"]
    smooth: Bool[np.ndarray, " n"]
    grey: Values
    step_m: Values
    u_by_motion: Derivative
    v_by_motion: Derivative
    grey_by_motion: Derivative
    step_by_motion: Derivative


def chosen_pixels(level: Level) -> Pixels:
    """Choose pixels where brightness is steep, and some others: a few edges may constrain one side only."""
    measured = level.depth_m > 0
    steep = cv2.magnitude(cv2.Sobel(level.grey, cv2.CV_32F, 1, 0), cv2.Sobel(level.grey, cv2.CV_32F, 0, 1))
    sample = steep[measured][::7]
    threshold = float(np.median(sample)) if len(sample) else 0.0
    chosen = np.concatenate(
        [
            _thinned(np.flatnonzero(measured & (steep > threshold)), STEEP_PIXELS),
            _thinned(np.flatnonzero(measured & (steep <= threshold)), EVEN_PIXELS),
        ]
    )
    rows, columns = np.divmod(chosen, level.camera.width)
    camera, depth_m = level.camera, level.depth_m[rows, columns]
    x = (columns - camera.cx) / camera.fx * depth_m
    y = (rows - camera.cy) / camera.fy * depth_m
    return Pixels(np.stack([x, y, depth_m]).astype(np.float32), level.grey[rows, columns])


def _thinned(numbers: np.ndarray, count: int) -> np.ndarray:
    return numbers[:: max(1, len(numbers) // count)]


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
    level = keyframe.levels[number]
    camera = level.camera
    keyframe_from_camera = (invert(keyframe.scene_from_camera) @ scene_from_camera).astype(np.float32)
    turned = keyframe_from_camera[:3, :3] @ pixels.points
    x, y, z = turned + keyframe_from_camera[:3, 3:]
    per_z = 1 / np.maximum(z, np.float32(1e-3))
    u, v = camera.fx * x * per_z + camera.cx, camera.fy * y * per_z + camera.cy
    seen = (z > 1e-3) & (u >= 1) & (u < camera.width - 2) & (v >= 1) & (v < camera.height - 2)
    u, v = np.where(seen, u, np.float32(0)), np.where(seen, v, np.float32(0))
    nearest_m = level.depth_m[np.rint(v).astype(int), np.rint(u).astype(int)]
    seen &= nearest_m > 0
    agrees = seen & (np.abs(nearest_m - z) < 0.02 * z + 0.005)
    grey, depth_m, *slopes = (
        channel
        for image in (level.grey, level.depth_m, keyframe.slopes[number])
        for channel in cv2.remap(image, u, v, cv2.INTER_LINEAR).reshape(len(u), -1).T
    )
    u_by, v_by, z_by = _by_motion(turned, per_z * camera.fx, per_z * camera.fy, x * per_z, y * per_z)
    compared = Compared(
        seen,
        agrees,
        agrees & np.isfinite(slopes[2]),
        grey,
        depth_m - z,
        u_by,
        v_by,
        slopes[0] * u_by + slopes[1] * v_by,
        slopes[2] * u_by + slopes[3] * v_by - z_by,
    )
    return compared, np.kron(np.eye(2), keyframe_from_camera[:3, :3].astype(float))


def _by_motion(
    turned: Float32[np.ndarray, "3 n"], fx_per_z: Values, fy_per_z: Values, x_per_z: Values, y_per_z: Values
) -> tuple[Derivative, Derivative, Derivative]:
    """Derivatives of u, v and z of points by a motion along the keyframe's axes.

    A motion (w, t) moves a point by ``w x turned + t``.
    """
    qx, qy, qz = turned
    zero = np.zeros_like(qx)
    du, dv = -fx_per_z * x_per_z, -fy_per_z * y_per_z  # by z
    u_by = np.stack([qy * du, qz * fx_per_z - qx * du, -qy * fx_per_z, fx_per_z, zero, du])
    v_by = np.stack([qy * dv - qz * fy_per_z, -qx * dv, qx * fy_per_z, zero, fy_per_z, dv])
    z_by = np.stack([qy, -qx, zero, zero, zero, zero + 1])
    return u_by, v_by, z_by
