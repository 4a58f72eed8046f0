"""Turn the differences between a frame and a keyframe into normal equations for the motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from rpl_data.reconstruct.comparison import Compared, Derivative, Values
from rpl_data.reconstruct.information import INDEPENDENT, Information, Motion, above_noise
from rpl_data.reconstruct.view import Pixels

LEAST_PIXELS = 100
"""With fewer pixels than this, the differences are ignored."""

GREY_NOISE, DEPTH_NOISE = 0.35, 0.15
"""Standard deviation of the noise of a slope, per unit of the noise of the difference of two pixels. Half of
the difference's variance comes from the keyframe; the filters that compute slopes reduce the rest."""


@dataclass(frozen=True)
class Evidence:
    """The normal equations of one kind of difference.

    Attributes:
        information, pull: matrix and right-hand side of the normal equations.
        weights: robust weight of each pixel.
        slope_noise: standard deviation of the noise of the keyframe's slopes.
    """

    information: Information
    pull: Motion
    weights: Values
    slope_noise: float

    def above_noise(self, compared: Compared) -> Information:
        """The information less that which the noise of the slopes alone would give."""
        weights = self.weights * np.float32(self.slope_noise**2)
        noise = np.zeros((6, 6))
        for derivative in (compared.by_motion(1.0, 0.0), compared.by_motion(0.0, 1.0)):
            noise += (derivative * weights) @ derivative.T
        return above_noise(self.information, noise)


def of_brightness(pixels: Pixels, compared: Compared) -> Evidence:
    """Evidence from brightness; a gain and an offset between the exposures are removed first."""
    some = compared.agrees[::4]
    gain, offset = _exposure(compared.grey[::4][some], pixels.grey[::4][some])
    residuals = pixels.grey - (gain * compared.grey + offset)
    derivative = compared.grey_by_motion
    derivative *= gain
    return _evidence(residuals, derivative, compared.agrees, slope_noise=GREY_NOISE, floor=1.0)


def of_depth(compared: Compared) -> Evidence:
    """Evidence from depth, in standard deviations of its noise."""
    return _evidence(
        -compared.step, compared.step_by_motion, compared.smooth, slope_noise=DEPTH_NOISE, floor=0.25
    )


def _evidence(
    residuals: Values,
    derivative: Derivative,
    use: Bool[np.ndarray, " n"],
    *,
    slope_noise: float,
    floor: float,
) -> Evidence:
    """Normal equations with Cauchy weights, whose scale is the residuals' own plus `floor`.

    Args:
        slope_noise: noise of the slopes for residuals of scale 1.
    """
    sizes = np.abs(residuals[use])
    count = len(sizes)
    if count < LEAST_PIXELS:
        return Evidence(np.zeros((6, 6)), np.zeros(6), np.zeros_like(residuals), slope_noise)
    sigma = 1.4826 * float(np.partition(sizes, count // 2)[count // 2]) + floor
    weights = use * np.float32(INDEPENDENT / sigma**2) / (1 + (residuals / np.float32(2 * sigma)) ** 2)
    weighted = derivative * weights
    information = (weighted @ derivative.T).astype(float)
    return Evidence(information, (weighted @ residuals).astype(float), weights, slope_noise * sigma)


def _exposure(there: Values, here: Values) -> tuple[np.float32, np.float32]:
    """Gain and offset between two exposures by a quarter of the pixels.

    From their quartiles, which misaligned edges hardly change.
    """
    if 4 * len(there) < LEAST_PIXELS:
        return np.float32(1), np.float32(0)
    quartiles = (np.array([0.25, 0.5, 0.75]) * len(there)).astype(int)
    a, b = np.sort(there)[quartiles], np.sort(here)[quartiles]
    gain = np.clip((b[2] - b[0]) / max(a[2] - a[0], np.float32(1)), np.float32(0.5), np.float32(2))
    return gain, b[1] - gain * a[1]
