"""Measure the camera's errors on recorded images of the objects."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from rpl_data.geometry import depth_sigma_m
from rpl_data.synthesize.compose import RIM_PX
from rpl_data.synthesize.studio import Noise
from rpl_data.types import ColorImage, DepthImage

BLOCK_PX = 16
FLATTEST = 10.0
"""Percentile of the blocks' noise that is taken for the camera's: the others have texture."""
MAD_SIGMA = 1.4826
NO_DEPTH = Noise(color=0.0, depth=1.0, lost_inside=0.0, lost_at_rim=0.0)


def color_noise(image: ColorImage) -> float:
    """Standard deviation of a pixel's noise in grey levels, from the flattest blocks of an image.

    Immerkaer, "Fast noise variance estimation", Computer Vision and Image Understanding 64, 1996: a mask that
    answers neither to gradients nor to edges, of which the mean absolute value is 6 sigma sqrt(2 / pi).
    """
    grey = image.astype(np.float32).mean(axis=2)
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    answer = np.abs(cv2.filter2D(grey, -1, kernel))
    small = (grey.shape[1] // BLOCK_PX, grey.shape[0] // BLOCK_PX)
    blocks = cv2.resize(answer, small, interpolation=cv2.INTER_AREA)
    one_channel = np.sqrt(np.pi / 2) / 6 * float(np.percentile(blocks, FLATTEST))
    return float(np.sqrt(3) * one_channel)  # grey is the mean of three


def depth_errors(
    model_m: Float32[np.ndarray, "h w"],
    visible: Bool[np.ndarray, "h w"],
    measured_m: DepthImage,
) -> tuple[float, float, float] | None:
    """Noise, share lost inside and share lost at the rim of an object in one image; None where it is small.

    Args:
        model_m: depth of the dense model.
        visible: where the object is seen.
        measured_m: the depth image, 0 = none.
    """
    inside = cv2.erode(visible.astype(np.uint8), np.ones((2 * RIM_PX + 1,) * 2, np.uint8)) > 0
    inside &= np.isfinite(model_m)
    rim = visible & ~inside
    known = inside & (measured_m > 0)
    if known.sum() < 100:
        return None
    off = (measured_m[known] - model_m[known]) / np.asarray(depth_sigma_m(model_m[known]))
    sigma = MAD_SIGMA * float(np.median(np.abs(off - np.median(off))))
    return sigma, float((measured_m[inside] <= 0).mean()), float((measured_m[rim] <= 0).mean())


def noise_of(colors: Sequence[float], depths: Sequence[tuple[float, float, float]]) -> Noise:
    """The medians over images; no depth noise is known without depth images."""
    color = float(np.median(colors)) if colors else 0.0
    if not depths:
        return Noise(color, NO_DEPTH.depth, NO_DEPTH.lost_inside, NO_DEPTH.lost_at_rim)
    return Noise(color, *(float(value) for value in np.median(np.array(depths), axis=0)))
