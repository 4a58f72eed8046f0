"""Measure the camera's errors on recorded images of the objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from rpl_data.geometry import depth_sigma_m
from rpl_data.synthesize.compose import RIM_PX
from rpl_data.synthesize.studio import DepthNoise
from rpl_data.types import ColorImage, DepthImage

BLOCK_PX = 16
FLATTEST = 10.0
"""Percentile of the blocks' noise that is taken for the camera's: the others have texture."""
MAD_SIGMA = 1.4826
LEAST_PIXELS = 100
"""With fewer an image says nothing of an object's depth, and with fewer depths nothing of their noise."""


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
) -> DepthNoise | None:
    """The errors of an object's depth in one image; None where it is small.

    The noise is NaN where hardly any depth was measured.

    Args:
        model_m: depth of the dense model.
        visible: where the object is seen.
        measured_m: the depth image, 0 = none.
    """
    inside = cv2.erode(visible.astype(np.uint8), np.ones((2 * RIM_PX + 1,) * 2, np.uint8)) > 0
    inside &= np.isfinite(model_m)
    rim = visible & ~inside
    known = inside & (measured_m > 0)
    if inside.sum() < LEAST_PIXELS:
        return None
    lost = float((measured_m[inside] <= 0).mean()), float((measured_m[rim] <= 0).mean())
    if known.sum() < LEAST_PIXELS:
        return DepthNoise(np.nan, *lost)
    off = (measured_m[known] - model_m[known]) / np.asarray(depth_sigma_m(model_m[known]))
    sigma = MAD_SIGMA * float(np.median(np.abs(off - np.median(off))))
    return DepthNoise(sigma, *lost)


def depth_noise(measured: Mapping[str, Sequence[DepthNoise]]) -> dict[str, DepthNoise]:
    """By object, the medians over its images.

    Where an object's noise is not known, it is that of all objects together; where nothing is known, that of
    `geometry.depth_sigma_m` without holes.
    """
    sigmas = [one.sigma for images in measured.values() for one in images if not np.isnan(one.sigma)]
    of_all = float(np.median(sigmas)) if sigmas else DepthNoise().sigma
    return {name: _middle(images, of_all) for name, images in measured.items()}


def _middle(images: Sequence[DepthNoise], otherwise: float) -> DepthNoise:
    if not images:
        return DepthNoise(otherwise)
    sigma, inside, rim = np.array([[one.sigma, one.lost_inside, one.lost_at_rim] for one in images]).T
    known = sigma[~np.isnan(sigma)]
    return DepthNoise(
        float(np.median(known)) if len(known) else otherwise, float(np.median(inside)), float(np.median(rim))
    )
