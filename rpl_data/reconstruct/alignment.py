"""A frame against a keyframe: pixel by pixel, brightness and depth.

Pixels of the frame are moved into the keyframe by the pose in question; there the keyframe should be as
bright (Steinbruecker et al., ICCV workshops 2011) and as far away, with robust weights for both (Kerl et
al., IROS 2013). What else is known of the pose enters the same normal equations as a Gaussian with its
own information, so each source decides where it knows more: on a plane colour alone holds the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from rpl_data.geometry import Transform, invert
from rpl_data.reconstruct.information import (
    INDEPENDENT,
    Estimate,
    Information,
    Motion,
    above_noise,
    motion_between,
    moved,
)
from rpl_data.reconstruct.model_map import Keyframe
from rpl_data.reconstruct.view import Level, View

STEEP_PIXELS = 2000
EVEN_PIXELS = 600
"""Pixels compared a level: about so many of the steepest brightness, and so many spread evenly."""

ITERATIONS = 4
"""Gauss-Newton steps a level."""

CONVERGED_M = 2e-5
LEAST_PIXELS = 100
GREY_NOISE, DEPTH_NOISE = 0.35, 0.15
"""Noise of a slope (of the smoothed depth, for depth) for one of the difference of two pixels; half of that
difference's variance is the keyframe's, and the filters of the slopes do the rest."""

PLAIN = 6.0
"""Brightness that varies less than this (standard deviation, of 255) shows nothing to correlate."""

Values = Float32[np.ndarray, " n"]
Derivative = Float32[np.ndarray, "6 n"]


@dataclass(frozen=True)
class Fit:
    """A frame aligned to a keyframe.

    Attributes:
        estimate: with the information of brightness, depth and what was known before.
        seen: share of the frame's pixels that lie in the keyframe's image.
        agreeing: share of those that are as far away as the keyframe says.
        correlation: of the brightness of those; NaN where there is nothing to see.
    """

    estimate: Estimate
    seen: float
    agreeing: float
    correlation: float


@dataclass(frozen=True)
class _Pixels:
    """Pixels of the frame: points in its camera, a column a pixel, and brightness."""

    points: Float32[np.ndarray, "3 n"]
    grey: Values


@dataclass(frozen=True)
class _Compared:
    """The pixels in the keyframe.

    Attributes:
        seen: they lie in its image where it has depth.
        agrees: at about its depth.
        smooth: and it has depth all around.
        grey, step_m: the keyframe's brightness, and how much farther than the pixel it is.
        u_by_motion, v_by_motion: derivatives of the place in its image by a motion along its axes.
        grey_by_motion, step_by_motion: of the other two.
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


def align(
    view: View,
    keyframe: Keyframe,
    start: Transform,
    prior: Estimate,
    *,
    levels: Sequence[int],
    color_trust: float = 1.0,
) -> Fit:
    """The pose of a frame that fits a keyframe's brightness and depth, and what is known before.

    Args:
        start: the pose to start at.
        prior: what is known before.
        levels: sizes of the images to use, in this order; 0 is the largest.
        color_trust: weight of brightness; 1 where depth lies on the pixels of the colour image.
    """
    pose = start
    for level in levels:
        pixels = _chosen_pixels(view.levels[level])
        for _ in range(ITERATIONS):
            compared, axes = _compare(pixels, keyframe, level, pose)
            bright, deep = _brightness(pixels, compared), _depth(compared)
            pull = axes.T @ (color_trust * bright.pull + deep.pull)
            pull += prior.information @ motion_between(pose, prior.scene_from_camera)
            information = axes.T @ (color_trust * bright.information + deep.information) @ axes
            motion = np.linalg.solve(information + prior.information, pull)
            pose = pose @ moved(motion)
            if np.abs(motion).max() < CONVERGED_M:
                break
    known = color_trust * bright.above_noise(compared) + deep.above_noise(compared)
    estimate = Estimate(pose, axes.T @ known @ axes + prior.information)
    return Fit(estimate, *_agreement(pixels, compared))


def _chosen_pixels(level: Level) -> _Pixels:
    """The steep half of the pixels, thinned evenly, and some of all: a few edges alone are one-sided."""
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
    return _Pixels(np.stack([x, y, depth_m]).astype(np.float32), level.grey[rows, columns])


def _thinned(numbers: np.ndarray, count: int) -> np.ndarray:
    return numbers[:: max(1, len(numbers) // count)]


def _compare(
    pixels: _Pixels, keyframe: Keyframe, number: int, scene_from_camera: Transform
) -> tuple[_Compared, Information]:
    """The pixels in the keyframe, and the axes that take a motion of the frame to one along its axes."""
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
    compared = _Compared(
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
    """Derivatives of u, v and z of points by a motion, with axes turned to the keyframe's.

    A motion (w, t) moves a point by ``w x turned + t``.
    """
    qx, qy, qz = turned
    zero = np.zeros_like(qx)
    du, dv = -fx_per_z * x_per_z, -fy_per_z * y_per_z  # by z
    u_by = np.stack([qy * du, qz * fx_per_z - qx * du, -qy * fx_per_z, fx_per_z, zero, du])
    v_by = np.stack([qy * dv - qz * fy_per_z, -qx * dv, qx * fy_per_z, zero, fy_per_z, dv])
    z_by = np.stack([qy, -qx, zero, zero, zero, zero + 1])
    return u_by, v_by, z_by


@dataclass(frozen=True)
class _Evidence:
    """What one kind of difference says about the motion.

    Attributes:
        information, pull: of the normal equations.
        weights: of the pixels.
        slope_noise: standard deviation of the keyframe's slopes.
    """

    information: Information
    pull: Motion
    weights: Values
    slope_noise: float

    def above_noise(self, compared: _Compared) -> Information:
        """The information without what noisy slopes show where there are none."""
        weights = self.weights * np.float32(self.slope_noise**2)
        u, v = compared.u_by_motion, compared.v_by_motion
        noise = (u * weights) @ u.T + (v * weights) @ v.T
        return above_noise(self.information, noise.astype(float))


def _brightness(pixels: _Pixels, compared: _Compared) -> _Evidence:
    """Differences of brightness, with a gain and an offset between the exposures."""
    gain, offset = _exposure(compared.grey[compared.agrees], pixels.grey[compared.agrees])
    residuals = pixels.grey - (gain * compared.grey + offset)
    return _evidence(
        residuals, gain * compared.grey_by_motion, compared.agrees, slope_noise=GREY_NOISE, floor=1.0
    )


def _depth(compared: _Compared) -> _Evidence:
    """Differences of depth."""
    return _evidence(
        -compared.step_m, compared.step_by_motion, compared.smooth, slope_noise=DEPTH_NOISE, floor=5e-4
    )


def _evidence(
    residuals: Values,
    derivative: Derivative,
    use: Bool[np.ndarray, " n"],
    *,
    slope_noise: float,
    floor: float,
) -> _Evidence:
    """Normal equations with Cauchy's weights; the scale is the residuals' own, and `floor` more.

    Args:
        slope_noise: for a scale of 1.
    """
    count = int(np.count_nonzero(use))
    if count < LEAST_PIXELS:
        return _Evidence(np.zeros((6, 6)), np.zeros(6), np.zeros_like(residuals), slope_noise)
    sizes = np.abs(residuals[use])
    sigma = 1.4826 * float(np.partition(sizes, count // 2)[count // 2]) + floor
    weights = use * np.float32(INDEPENDENT / sigma**2) / (1 + (residuals / np.float32(2 * sigma)) ** 2)
    weighted = np.where(use, derivative * weights, np.float32(0))
    derivative = np.where(use, derivative, np.float32(0))  # NaN near missing depth
    information = (weighted @ derivative.T).astype(float)
    return _Evidence(information, (weighted @ residuals).astype(float), weights, slope_noise * sigma)


def _exposure(there: Values, here: Values) -> tuple[np.float32, np.float32]:
    """Gain and offset between two exposures by quartiles: edges that do not meet yet hardly move them."""
    if len(there) < LEAST_PIXELS:
        return np.float32(1), np.float32(0)
    quartiles = (np.array([0.25, 0.5, 0.75]) * len(there[::4])).astype(int)
    a, b = np.sort(there[::4])[quartiles], np.sort(here[::4])[quartiles]
    gain = np.clip((b[2] - b[0]) / max(a[2] - a[0], np.float32(1)), np.float32(0.5), np.float32(2))
    return gain, b[1] - gain * a[1]


def _agreement(pixels: _Pixels, compared: _Compared) -> tuple[float, float, float]:
    """Shares seen and agreeing, and the correlation of brightness."""
    total, use = len(compared.seen), compared.agrees
    seen, agreeing = int(np.count_nonzero(compared.seen)), int(np.count_nonzero(use))
    correlation = float("nan")
    if agreeing >= LEAST_PIXELS and min(pixels.grey[use].std(), compared.grey[use].std()) > PLAIN:
        correlation = float(np.corrcoef(compared.grey[use], pixels.grey[use])[0, 1])
    return seen / max(total, 1), agreeing / max(seen, 1), correlation
