"""Lay drawn objects over a plate: colours with soft edges, shadow, noise and depth as the camera has them."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from rpl_data.geometry import depth_sigma_m
from rpl_data.raycast import PixelTable
from rpl_data.synthesize.light import Light
from rpl_data.synthesize.render import Alone, Drawing, Placed
from rpl_data.synthesize.shadow import shadows
from rpl_data.synthesize.studio import DepthNoise, Noise, Plane
from rpl_data.types import ColorImage, DepthImage

SOFT_PX = 0.5
"""Standard deviation by which lens and sensor soften what is drawn."""
GRAIN_PX = 2.0
"""Size of the grain of depth noise: stereo matches windows, so neighbouring pixels err alike."""
RIM_PX = 4
"""Pixels inside an outline where depth is lost more often."""


def laid_over(
    plate: ColorImage, drawing: Drawing, noise: Noise, rng: np.random.Generator, *, soft_px: float = SOFT_PX
) -> ColorImage:
    """Lay a drawing over a picture of the same size, with the camera's softness and noise."""
    color = cv2.GaussianBlur(drawing.color, (0, 0), soft_px)
    alpha = cv2.GaussianBlur(drawing.alpha, (0, 0), soft_px)[..., None]
    grain = rng.standard_normal(color.shape, dtype=np.float32) * np.float32(noise.color)
    mixed = plate * (1 - alpha) + color + grain * alpha
    return np.asarray(mixed.round().clip(0, 255).astype(np.uint8))


def shadowed(
    plate: ColorImage, table: PixelTable, objects: Sequence[Placed], plane: Plane | None, light: Light
) -> ColorImage:
    """Darken the table where objects keep the strongest light from it."""
    if plane is None or not objects:
        return plate
    factor = shadows(table, objects, plane, light)
    return plate if factor is None else (plate * factor[..., None]).round().astype(np.uint8)


def depth_over(
    plate_m: DepthImage, objects: Sequence[tuple[Alone, DepthNoise]], rng: np.random.Generator
) -> DepthImage:
    """Lay the depth of objects over that of a plate, each with its noise and holes."""
    nearest = np.full(plate_m.shape, np.inf, np.float32)
    which = np.zeros(plate_m.shape, np.intp)
    for number, (each, _) in enumerate(objects):
        before = each.depth_m < nearest[each.window]
        nearest[each.window][before] = each.depth_m[before]
        which[each.window][before] = number
    covered = np.isfinite(nearest)
    if not covered.any():
        return plate_m
    true_m = np.where(covered, nearest, 1).astype(np.float32)
    sigma_m = np.array([noise.sigma for _, noise in objects])[which] * np.asarray(depth_sigma_m(true_m))
    measured = true_m + (sigma_m * _grain(true_m.shape, rng)).astype(np.float32)
    lost = np.array([[noise.lost_at_rim, noise.lost_inside] for _, noise in objects])[which]
    measured[_lost(covered, lost, rng)] = 0
    return np.where(covered, measured, plate_m).astype(np.float32)


def _lost(
    covered: Bool[np.ndarray, "h w"], shares: Float64[np.ndarray, "h w 2"], rng: np.random.Generator
) -> Bool[np.ndarray, "h w"]:
    """Patches without depth; of each pixel, the shares at the rim and inside."""
    inside = cv2.erode(covered.astype(np.uint8), np.ones((2 * RIM_PX + 1,) * 2, np.uint8)) > 0
    share = np.where(inside, shares[..., 1], shares[..., 0])
    from scipy.special import ndtr

    lost: Bool[np.ndarray, "h w"] = covered & (ndtr(_grain(covered.shape, rng)) < share)
    return lost


def _grain(shape: tuple[int, ...], rng: np.random.Generator) -> Float32[np.ndarray, "h w"]:
    """Correlated noise of standard deviation 1."""
    white = rng.standard_normal(shape, dtype=np.float32)
    smooth = cv2.GaussianBlur(white, (0, 0), GRAIN_PX)
    # A Gaussian of this width averages 4 pi sigma^2 pixels.
    return np.asarray(smooth * np.float32(2 * np.sqrt(np.pi) * GRAIN_PX))
