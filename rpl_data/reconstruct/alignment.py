"""Align a frame to a keyframe by the brightness and depth of its pixels.

Pixels of the frame are projected into the keyframe by an estimated pose. There the brightness
(Steinbruecker et al., ICCV workshops 2011) and the depth of the keyframe should be the same; the differences
are the residuals, with robust weights (Kerl et al., IROS 2013). A prior on the pose enters the same normal
equations with its own information matrix. So each source counts where it is certain: on a plane, only
brightness constrains the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rpl_data.geometry import Transform
from rpl_data.reconstruct.comparison import Compared, compare
from rpl_data.reconstruct.evidence import LEAST_PIXELS, Evidence, of_brightness, of_depth
from rpl_data.reconstruct.information import Estimate, Information, motion_between, moved
from rpl_data.reconstruct.model_map import Keyframe
from rpl_data.reconstruct.view import Pixels, View

ITERATIONS = 4
"""Largest number of Gauss-Newton steps per level."""

NEAR, CONVERGED = 2e-3, 3e-4
"""The iteration ends after a step smaller than this, in radians and metres: on small images, and on the
largest."""

PLAIN = 6.0
"""Brightness with a smaller standard deviation than this (of 255) is too uniform to correlate."""


@dataclass(frozen=True)
class Fit:
    """A frame aligned to a keyframe.

    Attributes:
        estimate: the pose, with the information of brightness, depth and the prior.
        seen: share of the frame's pixels that project into the keyframe's image.
        agreeing: share of the seen pixels whose depth agrees with the keyframe's.
        correlation: correlation of the brightness of the agreeing pixels; NaN where it is too uniform.
    """

    estimate: Estimate
    seen: float
    agreeing: float
    correlation: float


def approach(
    view: View, keyframe: Keyframe, start: Transform, prior: Estimate, *, levels: Sequence[int] = (2, 1)
) -> Transform:
    """Bring the pose of a frame near the one that fits a keyframe, on small images.

    A shift of depth against brightness is small there, so brightness counts whether registered or not.
    """
    for level in levels:
        start = _descend(view, keyframe, start, prior, level, 1.0, NEAR)[0]
    return start


def align(
    view: View,
    keyframe: Keyframe,
    start: Transform,
    prior: Estimate,
    *,
    color_trust: float = 1.0,
) -> Fit:
    """Find the pose of a frame that fits a keyframe's brightness and depth, and the prior.

    Args:
        start: `scene_from_camera` of the frame, where the search starts; see `approach`.
        prior: what is known of the pose beforehand.
        color_trust: weight of brightness; 1 where depth is registered to colour.
    """
    pose, last = _descend(view, keyframe, start, prior, 0, color_trust, CONVERGED)
    compared = last.compared
    known = color_trust * last.bright.above_noise(compared) + last.deep.above_noise(compared)
    estimate = Estimate(pose, last.axes.T @ known @ last.axes + prior.information)
    return Fit(estimate, *_agreement(view.levels[0].pixels, compared))


@dataclass(frozen=True)
class _Step:
    """What the last step of an iteration saw; `axes` as `compare` returns it."""

    compared: Compared
    axes: Information
    bright: Evidence
    deep: Evidence


def _descend(
    view: View,
    keyframe: Keyframe,
    pose: Transform,
    prior: Estimate,
    level: int,
    color_trust: float,
    converged: float,
) -> tuple[Transform, _Step]:
    """Gauss-Newton at one level."""
    pixels = view.levels[level].pixels
    for _ in range(ITERATIONS):
        compared, axes = compare(pixels, keyframe, level, pose)
        bright, deep = of_brightness(pixels, compared), of_depth(compared)
        pull = axes.T @ (color_trust * bright.pull + deep.pull)
        pull += prior.information @ motion_between(pose, prior.scene_from_camera)
        information = axes.T @ (color_trust * bright.information + deep.information) @ axes
        motion = np.linalg.solve(information + prior.information, pull)
        pose = pose @ moved(motion)
        if np.abs(motion).max() < converged:
            break
    return pose, _Step(compared, axes, bright, deep)


def _agreement(pixels: Pixels, compared: Compared) -> tuple[float, float, float]:
    """The shares `seen` and `agreeing` and the `correlation` of a `Fit`."""
    total, use = len(compared.seen), compared.agrees
    seen, agreeing = int(np.count_nonzero(compared.seen)), int(np.count_nonzero(use))
    correlation = float("nan")
    if agreeing >= LEAST_PIXELS and min(pixels.grey[use].std(), compared.grey[use].std()) > PLAIN:
        correlation = float(np.corrcoef(compared.grey[use], pixels.grey[use])[0, 1])
    return seen / max(total, 1), agreeing / max(seen, 1), correlation
