"""A frame against a keyframe: pixel by pixel, brightness and depth.

Pixels of the frame are moved into the keyframe by the pose in question; there the keyframe should be as
bright (Steinbruecker et al., ICCV workshops 2011) and as far away, with robust weights for both (Kerl et
al., IROS 2013). What else is known of the pose enters the same normal equations as a Gaussian with its
own information, so each source decides where it knows more: on a plane brightness alone holds the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rpl_data.geometry import Transform
from rpl_data.reconstruct.comparison import Compared, Pixels, chosen_pixels, compare
from rpl_data.reconstruct.evidence import LEAST_PIXELS, of_brightness, of_depth
from rpl_data.reconstruct.information import Estimate, motion_between, moved
from rpl_data.reconstruct.model_map import Keyframe
from rpl_data.reconstruct.view import View

ITERATIONS = 4
"""Gauss-Newton steps a level."""

CONVERGED = 3e-4
"""Steps smaller than this, in radians and metres, are the last of a level."""

PLAIN = 6.0
"""Brightness that varies less than this (standard deviation, of 255) shows nothing to correlate."""


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
        pixels = chosen_pixels(view.levels[level])
        for _ in range(ITERATIONS):
            compared, axes = compare(pixels, keyframe, level, pose)
            bright, deep = of_brightness(pixels, compared), of_depth(compared)
            pull = axes.T @ (color_trust * bright.pull + deep.pull)
            pull += prior.information @ motion_between(pose, prior.scene_from_camera)
            information = axes.T @ (color_trust * bright.information + deep.information) @ axes
            motion = np.linalg.solve(information + prior.information, pull)
            pose = pose @ moved(motion)
            if np.abs(motion).max() < CONVERGED:
                break
    known = color_trust * bright.above_noise(compared) + deep.above_noise(compared)
    estimate = Estimate(pose, axes.T @ known @ axes + prior.information)
    return Fit(estimate, *_agreement(pixels, compared))


def _agreement(pixels: Pixels, compared: Compared) -> tuple[float, float, float]:
    """Shares seen and agreeing, and the correlation of brightness."""
    total, use = len(compared.seen), compared.agrees
    seen, agreeing = int(np.count_nonzero(compared.seen)), int(np.count_nonzero(use))
    correlation = float("nan")
    if agreeing >= LEAST_PIXELS and min(pixels.grey[use].std(), compared.grey[use].std()) > PLAIN:
        correlation = float(np.corrcoef(compared.grey[use], pixels.grey[use])[0, 1])
    return seen / max(total, 1), agreeing / max(seen, 1), correlation
