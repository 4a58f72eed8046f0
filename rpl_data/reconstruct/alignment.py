"""A frame against a keyframe: pixel by pixel, brightness and depth.

Pixels of the frame are moved into the keyframe by the pose in question; there the keyframe should be as
bright (Steinbruecker et al., ICCV workshops 2011) and as far away, with robust weights for both (Kerl et
al., IROS 2013). What else is known of the pose enters the same normal equations as a Gaussian with its
own information, so each source decides where it knows more: on a plane colour alone holds the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

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
Derivative = Float32[np.ndarray, "n 6"]


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
    """Pixels of the frame: points in its camera, and brightness."""

    points: Float32[np.ndarray, "n 3"]
    grey: Values


@dataclass(frozen=True)
class _Compared:
    """The pixels in the keyframe.

    Attributes:
        seen: they lie in its image where it has depth.
        agrees: at about its depth.
        smooth: and it has depth all around.
        grey, step_m: the keyframe's brightness, and how much farther than the pixel it is.
        u_by_motion, v_by_motion: derivatives of the pixel's place in the keyframe by the motion.
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
            compared = _compare(pixels, keyframe, level, pose)
            bright, deep = _brightness(pixels, compared), _depth(compared)
            pull = color_trust * bright.pull + deep.pull
            pull += prior.information @ motion_between(pose, prior.scene_from_camera)
            motion = np.linalg.solve(
                color_trust * bright.information + deep.information + prior.information, pull
            )
            pose = pose @ moved(motion)
            if np.abs(motion).max() < CONVERGED_M:
                break
    known = color_trust * above_noise(bright.information, bright.noise)
    known = known + above_noise(deep.information, deep.noise) + prior.information
    return Fit(Estimate(pose, known), *_agreement(pixels, compared))


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
    points = np.column_stack([x, y, depth_m]).astype(np.float32)
    return _Pixels(points, level.grey[rows, columns])


def _thinned(numbers: np.ndarray, count: int) -> np.ndarray:
    return numbers[:: max(1, len(numbers) // count)]


def _compare(pixels: _Pixels, keyframe: Keyframe, number: int, scene_from_camera: Transform) -> _Compared:
    level = keyframe.levels[number]
    camera = level.camera
    keyframe_from_camera = (invert(keyframe.scene_from_camera) @ scene_from_camera).astype(np.float32)
    rotation = keyframe_from_camera[:3, :3]
    x, y, z = (pixels.points @ rotation.T + keyframe_from_camera[:3, 3]).T
    per_z = 1 / np.maximum(z, 1e-3)
    u, v = camera.fx * x * per_z + camera.cx, camera.fy * y * per_z + camera.cy
    seen = (z > 1e-3) & (u >= 1) & (u < camera.width - 2) & (v >= 1) & (v < camera.height - 2)
    u, v = np.where(seen, u, 0).astype(np.float32), np.where(seen, v, 0).astype(np.float32)
    nearest_m = level.depth_m[np.rint(v).astype(int), np.rint(u).astype(int)]
    seen &= nearest_m > 0
    agrees = seen & (np.abs(nearest_m - z) < 0.02 * z + 0.005)
    grey, depth_m, slopes = (
        cv2.remap(image, u, v, cv2.INTER_LINEAR).reshape(len(u), -1)
        for image in (level.grey, level.depth_m, keyframe.slopes[number])
    )

    def by_motion(by_point: list[Any]) -> Derivative:
        """A derivative by the point in the keyframe, turned into the frame, then by the camera's motion."""
        turned = np.stack(np.broadcast_arrays(*by_point), axis=1) @ rotation
        return np.hstack([np.cross(pixels.points, turned), turned])

    zero = np.zeros_like(z)
    u_by_motion = by_motion([camera.fx * per_z, zero, -camera.fx * x * per_z**2])
    v_by_motion = by_motion([zero, camera.fy * per_z, -camera.fy * y * per_z**2])
    return _Compared(
        seen,
        agrees,
        agrees & np.isfinite(slopes[:, 2]),
        grey[:, 0],
        depth_m[:, 0] - z,
        u_by_motion,
        v_by_motion,
        slopes[:, :1] * u_by_motion + slopes[:, 1:2] * v_by_motion,
        slopes[:, 2:3] * u_by_motion + slopes[:, 3:] * v_by_motion - by_motion([zero, zero, zero + 1]),
    )


@dataclass(frozen=True)
class _Evidence:
    """What one kind of difference says about the motion.

    Attributes:
        information, pull: of the normal equations.
        noise: information that noisy slopes would show where there are none.
    """

    information: Information
    pull: Motion
    noise: Information


def _brightness(pixels: _Pixels, compared: _Compared) -> _Evidence:
    """Differences of brightness, with a gain and an offset between the exposures."""
    use = compared.agrees
    if np.count_nonzero(use) < LEAST_PIXELS:
        return _Evidence(np.zeros((6, 6)), np.zeros(6), np.zeros((6, 6)))
    there, here = compared.grey[use].astype(float), pixels.grey[use].astype(float)
    gain, offset = _exposure(there, here)
    residuals = here - (gain * there + offset)
    return _evidence(compared, use, residuals, gain * compared.grey_by_motion[use], GREY_NOISE, floor=1.0)


def _depth(compared: _Compared) -> _Evidence:
    """Differences of depth."""
    use = compared.smooth
    if np.count_nonzero(use) < LEAST_PIXELS:
        return _Evidence(np.zeros((6, 6)), np.zeros(6), np.zeros((6, 6)))
    residuals = -compared.step_m[use].astype(float)
    return _evidence(compared, use, residuals, compared.step_by_motion[use], DEPTH_NOISE, floor=5e-4)


def _evidence(
    compared: _Compared,
    use: Bool[np.ndarray, " n"],
    residuals: Float64[np.ndarray, " m"],
    derivative: Float32[np.ndarray, "m 6"] | Float64[np.ndarray, "m 6"],
    slope_noise: float,
    *,
    floor: float,
) -> _Evidence:
    """Normal equations with Cauchy's weights; the scale is the residuals' own, and `floor` more."""
    sigma = 1.4826 * float(np.median(np.abs(residuals))) + floor
    weights = INDEPENDENT / sigma**2 / (1 + (residuals / (2 * sigma)) ** 2)
    weighted = derivative * weights[:, None]
    moves = np.vstack([compared.u_by_motion[use], compared.v_by_motion[use]]).astype(float)
    noise = moves.T @ (moves * np.tile(weights, 2)[:, None]) * (slope_noise * sigma) ** 2
    return _Evidence(weighted.T @ derivative, weighted.T @ residuals, noise)


def _exposure(there: Float64[np.ndarray, " n"], here: Float64[np.ndarray, " n"]) -> tuple[float, float]:
    """Gain and offset between two exposures by quartiles: edges that do not meet yet hardly move them."""
    a, b = np.percentile(there, [25, 50, 75]), np.percentile(here, [25, 50, 75])
    gain = float(np.clip((b[2] - b[0]) / max(a[2] - a[0], 1.0), 0.5, 2.0))
    return gain, float(b[1] - gain * a[1])


def _agreement(pixels: _Pixels, compared: _Compared) -> tuple[float, float, float]:
    """Shares seen and agreeing, and the correlation of brightness."""
    total, use = len(compared.seen), compared.agrees
    seen, agreeing = int(np.count_nonzero(compared.seen)), int(np.count_nonzero(use))
    correlation = float("nan")
    if agreeing >= LEAST_PIXELS and min(pixels.grey[use].std(), compared.grey[use].std()) > PLAIN:
        correlation = float(np.corrcoef(compared.grey[use], pixels.grey[use])[0, 1])
    return seen / max(total, 1), agreeing / max(seen, 1), correlation
