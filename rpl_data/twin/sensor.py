"""What a stereo depth camera such as the RealSense D435 makes of a perfect image.

Every effect has its own switch, so that a test can measure it alone and an experiment can do without.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from rpl_data.geometry import depth_sigma_m
from rpl_data.types import ColorImage, DepthImage


@dataclass(frozen=True)
class DepthSensor:
    """Errors of the depth image; set a number to 0 to switch its effect off.

    Attributes:
        noise: factor on `geometry.depth_sigma_m` (1.5 mm at 0.7 m, growing with the square of the
            distance, as triangulation has it).
        grain_px: size of the grain of that noise (standard deviation of a Gaussian). Stereo matches
            windows, so neighbours err alike (Keselman et al., "Intel RealSense stereoscopic depth
            cameras", CVPRW 2017).
        bleed_px: how far an outline wanders to either side, standard deviation; the depth there is
            that of the other surface. 0.8 px in Nguyen, Izadi & Lovell, "Modeling Kinect sensor noise",
            3DIMPVT 2012, for a structured light sensor; stereo windows give more ("edge fattening",
            Scharstein & Szeliski, IJCV 47, 2002).
        dropout: share of pixels without depth next to an outline.
        outline_m: step of depth that is an outline.
        baseline_m: distance of the two imagers (50 mm in a D435). What only one of them sees, left of
            things in front, has no depth (D400 series datasheet, "invalid depth band", is the same at
            the image border and is left out here).
        grazing_deg: surfaces seen at less than this angle to the surface lose depth (Nguyen et al.
            lose it beyond 70 degrees from the normal).
        nearest_m, farthest_m: no depth outside.
        quantum_m: a unit of the stored image, millimetres.
    """

    noise: float = 1.0
    grain_px: float = 1.0
    bleed_px: float = 1.0
    dropout: float = 0.35
    outline_m: float = 0.015
    baseline_m: float = 0.05
    grazing_deg: float = 12.0
    nearest_m: float = 0.2
    farthest_m: float = 6.0
    quantum_m: float = 0.001


@dataclass(frozen=True)
class ColorSensor:
    """Errors of the colour image; set a number to 0 to switch its effect off.

    Attributes:
        blur_px: of lens, Bayer pattern and sharpening; standard deviation of a Gaussian.
        noise: standard deviation in dark parts, grey levels.
        shot_noise: standard deviation at white is this much more, grey levels (EMVA 1288: variance grows
            with the light).
        exposure: spread of the brightness from frame to frame, relative.
        jpeg_quality: 1 to 100.
    """

    blur_px: float = 0.55
    noise: float = 1.2
    shot_noise: float = 2.0
    exposure: float = 0.02
    jpeg_quality: int = 92


PERFECT_DEPTH = DepthSensor(
    noise=0.0,
    bleed_px=0.0,
    dropout=0.0,
    baseline_m=0.0,
    grazing_deg=0.0,
    nearest_m=0.0,
    farthest_m=float("inf"),
    quantum_m=0.0,
)
"""No effect at all; `dataclasses.replace` adds one."""


def measure_depth(
    depth_m: DepthImage,
    cos_incidence: Float32[np.ndarray, "height width"],
    sensor: DepthSensor,
    *,
    focal_px: float,
    rng: np.random.Generator,
) -> DepthImage:
    """The depth image the sensor gives for the true one; metres, 0 = none."""
    lost = (depth_m < sensor.nearest_m) | (depth_m > sensor.farthest_m) | (depth_m <= 0)
    lost |= _grazing_holes(cos_incidence, sensor.grazing_deg, rng)
    if sensor.baseline_m > 0:
        lost |= half_occluded(depth_m, focal_px=focal_px, baseline_m=sensor.baseline_m)
    measured = _bled(depth_m, cos_incidence, sensor.bleed_px, focal_px, rng)
    if sensor.dropout > 0:
        ragged = _grain(rng, depth_m.shape, 1.0)
        near_outline = outlines(measured, step_m=sensor.outline_m)
        lost |= near_outline & (ragged > _normal_quantile(1 - sensor.dropout))
    if sensor.noise > 0:
        sigma_m = np.asarray(depth_sigma_m(measured), dtype=np.float32)
        measured = measured + np.float32(sensor.noise) * sigma_m * _grain(rng, depth_m.shape, sensor.grain_px)
    if sensor.quantum_m > 0:
        measured = np.round(measured / np.float32(sensor.quantum_m)) * np.float32(sensor.quantum_m)
    return np.where(lost, np.float32(0), measured).clip(0).astype(np.float32)


def half_occluded(
    depth_m: DepthImage, *, focal_px: float, baseline_m: float
) -> Bool[np.ndarray, "height width"]:
    """Pixels the right imager does not see: something to their right lands on or left of them there."""
    columns = np.arange(depth_m.shape[1], dtype=np.float32)
    disparity = focal_px * baseline_m / np.where(depth_m > 0, depth_m, np.inf)
    right = columns - disparity
    leftmost = np.minimum.accumulate(right[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(depth_m.shape, dtype=bool)
    hidden[:, :-1] = leftmost[:, 1:] < right[:, :-1] - 0.5  # half a pixel: slanted surfaces stay
    return hidden


def outlines(depth_m: DepthImage, *, step_m: float) -> Bool[np.ndarray, "height width"]:
    """Pixels with a step of depth to one of their eight neighbours."""
    kernel = np.ones((3, 3), np.uint8)
    steps: Bool[np.ndarray, "height width"] = (
        cv2.dilate(depth_m, kernel) - cv2.erode(depth_m, kernel)
    ) > step_m
    return steps


def _bled(
    depth_m: DepthImage,
    cos_incidence: Float32[np.ndarray, "height width"],
    bleed_px: float,
    focal_px: float,
    rng: np.random.Generator,
) -> DepthImage:
    """Every pixel takes the depth of a pixel near by; the shift varies slowly, so outlines wander.

    Within a surface the shift would add noise of its own, so only pixels that end up on another
    surface (a jump beyond what the slope of their own explains) take it.
    """
    if bleed_px <= 0:
        return depth_m
    height, width = depth_m.shape
    v, u = np.mgrid[:height, :width].astype(np.float32)
    shift_u = np.float32(bleed_px) * _grain(rng, depth_m.shape, 3.0)
    shift_v = np.float32(bleed_px) * _grain(rng, depth_m.shape, 3.0)
    nearest = (u + shift_u).round(), (v + shift_v).round()
    other = cv2.remap(depth_m, *nearest, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    tangent = np.sqrt(1 / np.square(cos_incidence.clip(0.2, 1)) - 1)  # a contour has no slope to speak of
    slope_m = 1.5 * (np.hypot(shift_u, shift_v) + 0.7) * depth_m / focal_px * tangent
    elsewhere = np.abs(other - depth_m) > 0.01 * depth_m + slope_m
    return np.where(elsewhere, other, depth_m).astype(np.float32)


def _grazing_holes(
    cos_incidence: Float32[np.ndarray, "height width"], grazing_deg: float, rng: np.random.Generator
) -> Bool[np.ndarray, "height width"]:
    """Holes that are certain at 0 degrees and rare at `grazing_deg`."""
    if grazing_deg <= 0:
        return np.zeros(cos_incidence.shape, dtype=bool)
    chance = 1 - cos_incidence / np.sin(np.deg2rad(grazing_deg))
    holes: Bool[np.ndarray, "height width"] = rng.random(cos_incidence.shape, dtype=np.float32) < chance
    return holes


def _grain(
    rng: np.random.Generator, shape: tuple[int, ...], size_px: float
) -> Float32[np.ndarray, "height width"]:
    """Normal noise with unit variance whose neighbours are alike over `size_px`."""
    white = rng.standard_normal(shape, dtype=np.float32)
    if size_px <= 0:
        return white
    reach = int(4 * size_px) + 1
    kernel = cv2.getGaussianKernel(2 * reach + 1, size_px, cv2.CV_32F)
    kernel = kernel / np.sqrt((kernel**2).sum(), dtype=np.float32)  # so that the variance stays 1
    smooth = cv2.sepFilter2D(white, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(smooth, dtype=np.float32)


def _normal_quantile(share: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(share))


def measure_color(color: ColorImage, sensor: ColorSensor, *, rng: np.random.Generator) -> ColorImage:
    """The colour image before compression: blur, exposure and noise."""
    sharp = color.astype(np.float32)
    blurred = cv2.GaussianBlur(sharp, (0, 0), sensor.blur_px) if sensor.blur_px > 0 else sharp
    image = np.asarray(blurred, dtype=np.float32)
    image *= np.float32(1 + sensor.exposure * rng.standard_normal())
    sigma = np.sqrt(np.float32(sensor.noise**2) + np.float32(sensor.shot_noise**2) / 255 * image.clip(0, 255))
    image += sigma * rng.standard_normal(image.shape, dtype=np.float32)
    return np.round(image).clip(0, 255).astype(np.uint8)
