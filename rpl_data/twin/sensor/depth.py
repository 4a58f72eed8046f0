"""The depth image of an active stereo camera.

The defaults were fitted to a real hand-held D435 at 640 x 480 that films a printed cube of known pose from
0.47 m. Each figure is the real camera's; the twin's, for a printed carton at the same distance, follows in
brackets. Focal length x baseline: 19.3 m px, and disparities in steps of 1/32 px, read off the stored values
(the same). Noise of smooth surfaces: 0.075 px (the same), correlated over 4 px; residual of a plane through a
face: 2.4 mm scaled to 0.7 m (2.5); it grows with the incidence: 1.6 to 2 mm below 65 degrees, 3.4 at 65 to
70, 6 to 13 at 75 to 80 (0.8 to 1.6; 2.3; 6.1). Pixels without depth: under 1 % up to 75 degrees (1), 4 to
20 % from 75 to 80 (16), 40 % beyond (50); inside a silhouette, 0 to 4 px from its edge: 15, 13, 11, 9, 6 %
(14, 12, 10, 7, 6); outside it: 20 to 31 % (20 to 38). Clicks on corners with 1.5 px of noise: 20 % without
depth (20), 35 % more than 10 mm off (12; the rest comes from registration and from depth lagging colour, see
`Sensor`).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from rpl_data.twin.sensor.outline import Outlines, find_outlines
from rpl_data.types import DepthImage

Share = Float32[np.ndarray, "height width"]
"""One number per pixel, mostly 0 to 1."""


@dataclass(frozen=True)
class PerfectView:
    """The image that a depth camera without errors would see.

    Attributes:
        depth_m: depth along the optical axis; 0 where there is nothing.
        cos_incidence: cosine of the angle between the ray and the surface's normal; 0 = grazing.
        albedo: share of the light that the surface reflects, linear.
        shininess: 0 (paper) to 1 (polished metal).
    """

    depth_m: DepthImage
    cos_incidence: Share
    albedo: Share
    shininess: Share


def shifted(view: PerfectView, shift_px: tuple[float, float]) -> PerfectView:
    """Move the view right and down in the image, as a wrong registration does."""
    if shift_px == (0.0, 0.0):
        return view
    height, width = view.depth_m.shape
    v, u = np.mgrid[:height, :width].astype(np.float32)
    at = (u - np.float32(shift_px[0])).round(), (v - np.float32(shift_px[1])).round()
    moved = (
        np.asarray(cv2.remap(channel, *at, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT), np.float32)
        for channel in (view.depth_m, view.cos_incidence, view.albedo, view.shininess)
    )
    return PerfectView(*moved)


@dataclass(frozen=True)
class DepthSensor:
    """Errors of the depth image; set a number to 0 to switch its effect off.

    Attributes:
        focal_px: focal length of the two infrared imagers; 386 in a D435 at 640 x 480.
        baseline_m: distance of the two imagers. What only one of them sees, to the left of things in front,
            has no depth (the same effect at the image's border, "invalid depth band" in the D400 series
            datasheet, is left out). 0 switches this off, and `subpixel_px` and `disparity_step_px` with it.
        subpixel_px: standard deviation of the disparity's noise; that of the depth is
            z^2 / (focal_px baseline_m) times it (Keselman et al., "Intel RealSense stereoscopic depth
            cameras", CVPRW 2017; Intel's "Tuning depth cameras for best performance" has 0.1 px for a
            well-textured target and less).
        slope_noise: factor on the noise that a slanted surface adds, 0.1 mm / sqrt(z) (t / (90 deg - t))^2 at
            the incidence t (Nguyen, Izadi & Lovell, "Modeling Kinect sensor noise for improved 3D
            reconstruction and tracking", 3DIMPVT 2012, their eq. 5).
        grain_px: size of the grain of that noise, standard deviation of a Gaussian. Stereo matches windows,
            so neighbouring pixels have similar errors.
        disparity_step_px: disparities are stored in steps of this; five binary digits after the point in
            the D4 processor.
        fatten_px: how much larger things look than they are, on every side: matching windows that contain
            both surfaces match the nearer one (edge fattening, Scharstein & Szeliski, IJCV 47, 2002).
        bleed_px: standard deviation of the outline's position around that; pixels in between have the depth
            of the other surface. 0.8 px lateral noise in Nguyen et al.
        outline_m: a step of depth larger than this, beyond what slope explains, is an outline.
        dropout: share of pixels without depth behind an outline, right beside it; half of that in front.
        dropout_px: distance behind the outline at which that share has fallen to 0; a third of it in front.
        grazing_deg: surfaces seen at less than this angle to the surface lose depth, more at smaller angles.
        dimmest: surfaces that reflect a smaller share of the light than this (albedo without the gloss,
            times the cosine) lose depth, darker ones more.
        glare: share of pixels without depth where polished metal reflects the projector's light straight
            back, within some 12 degrees of facing the camera.
        nearest_m, farthest_m: no depth outside these. 0.175 m is the D435's MinZ at 640 x 480 (datasheet).
        quantum_m: unit of the stored image.
    """

    focal_px: float = 386.0
    baseline_m: float = 0.05
    subpixel_px: float = 0.075
    slope_noise: float = 1.0
    grain_px: float = 4.0
    disparity_step_px: float = 1 / 32
    fatten_px: float = 0.5
    bleed_px: float = 0.8
    outline_m: float = 0.015
    dropout: float = 0.3
    dropout_px: float = 12.0
    grazing_deg: float = 15.0
    dimmest: float = 0.01
    glare: float = 1.0
    nearest_m: float = 0.175
    farthest_m: float = 6.0
    quantum_m: float = 0.001

    @property
    def triangulation_m_px(self) -> float:
        """Depth times disparity, in m px."""
        return self.focal_px * self.baseline_m


PERFECT_DEPTH = DepthSensor(
    baseline_m=0.0,
    subpixel_px=0.0,
    slope_noise=0.0,
    disparity_step_px=0.0,
    fatten_px=0.0,
    bleed_px=0.0,
    dropout=0.0,
    grazing_deg=0.0,
    dimmest=0.0,
    glare=0.0,
    nearest_m=0.0,
    farthest_m=float("inf"),
    quantum_m=0.0,
)
"""No effect at all; add single effects with `dataclasses.replace`."""


def measure_depth(
    view: PerfectView, sensor: DepthSensor, *, focal_px: float, rng: np.random.Generator
) -> DepthImage:
    """Return the depth image that the sensor records of the true one; metres, 0 = none.

    Args:
        focal_px: focal length of the image, which is the colour camera's since depth comes registered.
    """
    depth_m = view.depth_m
    outlines = find_outlines(depth_m, view.cos_incidence, step_m=sensor.outline_m, focal_px=focal_px)
    lost = (depth_m < sensor.nearest_m) | (depth_m > sensor.farthest_m) | (depth_m <= 0)
    lost |= half_occluded(depth_m, focal_px=focal_px, baseline_m=sensor.baseline_m)
    kept = (1 - _dropped(outlines, sensor)) * (1 - _unseen(view, sensor))
    if kept.min() < 1:
        lost |= _ragged(rng, 1 - kept)
    measured = _bled(depth_m, outlines, sensor, rng)
    measured += _sigma_m(measured, view.cos_incidence, sensor) * grain(rng, depth_m.shape, sensor.grain_px)
    measured = _rounded(measured, sensor)
    return np.where(lost, np.float32(0), measured).clip(0).astype(np.float32)


# Where there is no depth --------------------------------------------------------------------------


def half_occluded(
    depth_m: DepthImage, *, focal_px: float, baseline_m: float
) -> Bool[np.ndarray, "height width"]:
    """Pixels that the right imager does not see: something to their right projects onto or beyond them."""
    columns = np.arange(depth_m.shape[1], dtype=np.float32)
    disparity = focal_px * baseline_m / np.where(depth_m > 0, depth_m, np.inf)
    right = columns - disparity
    leftmost = np.minimum.accumulate(right[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(depth_m.shape, dtype=bool)
    hidden[:, :-1] = leftmost[:, 1:] < right[:, :-1] - 0.5  # half a pixel, so that slanted surfaces stay
    return hidden


def _dropped(outlines: Outlines, sensor: DepthSensor) -> Share:
    """Share of pixels that lose depth near outlines; it falls linearly with the distance."""
    if sensor.dropout <= 0 or sensor.dropout_px <= 0:
        return np.zeros_like(outlines.nearer_px)
    behind = 1 - outlines.nearer_px / np.float32(sensor.dropout_px)
    before = (1 - outlines.farther_px / np.float32(sensor.dropout_px / 3)) / 2
    dropped: Share = np.float32(sensor.dropout) * np.maximum(behind, before).clip(0, 1)
    return dropped


def _unseen(view: PerfectView, sensor: DepthSensor) -> Share:
    """Share of pixels that lose depth on grazing, dark and shiny surfaces."""
    kept = np.ones_like(view.depth_m)
    if sensor.grazing_deg > 0:
        kept *= (view.cos_incidence / np.float32(np.sin(np.deg2rad(sensor.grazing_deg)))).clip(0, 1)
    if sensor.dimmest > 0:
        diffuse = view.albedo * (1 - view.shininess) * view.cos_incidence
        kept *= (diffuse / np.float32(sensor.dimmest)).clip(0, 1)
    lobe = np.power(view.cos_incidence, 32)
    kept *= 1 - (np.float32(sensor.glare) * view.shininess * lobe).clip(0, 1)
    unseen: Share = 1 - kept
    return unseen


def _ragged(rng: np.random.Generator, share: Share) -> Bool[np.ndarray, "height width"]:
    """Draw patches that cover the given share of the pixels."""
    from scipy.special import ndtr

    level = ndtr(grain(rng, share.shape, 1.0))
    holes: Bool[np.ndarray, "height width"] = level < share
    return holes


# Wrong depth --------------------------------------------------------------------------------------


def _bled(
    depth_m: DepthImage, outlines: Outlines, sensor: DepthSensor, rng: np.random.Generator
) -> DepthImage:
    """Move outlines outwards by `fatten_px` on average; the shift varies slowly, so they wander."""
    if sensor.bleed_px <= 0 and sensor.fatten_px == 0:
        return depth_m.copy()
    outwards_px = np.float32(sensor.fatten_px) + np.float32(sensor.bleed_px) * grain(rng, depth_m.shape, 3.0)
    grown = np.where(outwards_px >= outlines.nearer_px - 0.5, outlines.nearer_m, depth_m)
    return np.where(-outwards_px >= outlines.farther_px - 0.5, outlines.farther_m, grown).astype(np.float32)


def _sigma_m(depth_m: DepthImage, cos_incidence: Share, sensor: DepthSensor) -> Share:
    """Standard deviation of the noise along the optical axis."""
    sigma_m = np.zeros_like(depth_m)
    if sensor.triangulation_m_px > 0:
        sigma_m += np.float32(sensor.subpixel_px / sensor.triangulation_m_px) * np.square(depth_m)
    if sensor.slope_noise > 0:
        incidence = np.arccos(cos_incidence.clip(0.17, 1))  # Nguyen et al. measured up to 80 degrees
        slant = np.square(incidence / (np.float32(np.pi / 2) - incidence))
        sigma_m += np.float32(1e-4 * sensor.slope_noise) * slant / np.sqrt(depth_m.clip(1e-3))
    return sigma_m


def _rounded(depth_m: DepthImage, sensor: DepthSensor) -> DepthImage:
    """Round depth to steps of the disparity, then to units of the stored image."""
    rounded = depth_m
    if sensor.disparity_step_px > 0 and sensor.triangulation_m_px > 0:
        steps = np.float32(sensor.triangulation_m_px / sensor.disparity_step_px)
        rounded = steps / np.round(steps / depth_m.clip(1e-3)).clip(1)
    if sensor.quantum_m > 0:
        rounded = np.round(rounded / np.float32(sensor.quantum_m)) * np.float32(sensor.quantum_m)
    return rounded


def grain(
    rng: np.random.Generator, shape: tuple[int, ...], size_px: float
) -> Float32[np.ndarray, "height width"]:
    """Normal noise with unit variance, correlated over `size_px`."""
    white = rng.standard_normal(shape, dtype=np.float32)
    if size_px <= 0:
        return white
    reach = int(4 * size_px) + 1
    kernel = cv2.getGaussianKernel(2 * reach + 1, size_px, cv2.CV_32F)
    kernel = kernel / np.sqrt((kernel**2).sum(), dtype=np.float32)  # so that the variance stays 1
    smooth = cv2.sepFilter2D(white, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(smooth, dtype=np.float32)
