"""Do depth edges lie on colour edges? Lag and registration of the two cameras, from the images alone.

An object's outline is an edge in both images. Depth edges of frame t + lag are correlated with colour
edges of frame t over all shifts, and the correlations are added over the frames: what is wrong in all of
them alike (a shift, a lag) adds up, everything else averages out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Complex64, Float, Float32, Float64, Int64
from scipy.fft import irfft2, rfft2
from scipy.special import ndtr

from rpl_data.types import ColorImage, DepthImage

STEP_PX = 2
"""Edges are looked for at half the resolution; a lag or a shift worth mending is larger than that."""

SURROUNDINGS = 31
"""Side of the square an edge is compared with, in pixels of the small image."""

NEARLY_PX = 6.0
"""Edges of depth are uncertain by this much; a registration within it is as good as can be seen."""

Edges = Float32[np.ndarray, "rows columns"]
Spectrum = Complex64[np.ndarray, "rows half"]


@dataclass(frozen=True)
class Pair:
    """Edge images of one frame, at 1 / `STEP_PX` of the resolution."""

    color: Edges
    depth: Edges


@dataclass(frozen=True)
class Alignment:
    """Where colour and depth edges meet best.

    Attributes:
        lag_frames: depth images are this many frames late.
        shift_px: colour edges are found at depth edges + shift (u, v), at that lag.
        lag_sigma, shift_sigma_px: standard errors by the jackknife (Efron and Stein, 1981); large
            where there are too few edges to tell.
        contrast: how many times higher the peak is than the correlation of the images as they are
            (no lag, hardly a shift); 1 when that is the peak. Print along an object's edges can make
            a second peak that is as high.
    """

    lag_frames: float
    shift_px: Float64[np.ndarray, "2"]
    lag_sigma: float
    shift_sigma_px: float
    contrast: float

    def sure_of_lag(self, least_frames: float) -> float:
        """Probability that the lag is larger than that."""
        return _beyond(abs(self.lag_frames), self.lag_sigma, least_frames)

    def sure_of_shift(self, least_px: float) -> float:
        """Probability that the shift is larger than that."""
        return _beyond(float(np.linalg.norm(self.shift_px)), self.shift_sigma_px, least_px)


def edges_of(color: ColorImage, depth_m: DepthImage) -> Pair:
    """Edges of a frame: gradients of colour, and the near side of steps of depth."""
    return Pair(_color_edges(color), _depth_edges(depth_m))


def align(
    pairs: Mapping[int, Pair], *, max_lag: int = 5, reach_px: float = 40.0, groups: int = 8
) -> Alignment:
    """Correlate the depth edges of frame t + lag with the colour edges of frame t, summed over all t.

    Args:
        pairs: edge images by position in the recording; frames whose partner is not there do not count.
        max_lag: lags from -max_lag to max_lag frames are tried.
        reach_px: shifts up to this are looked at.
        groups: for the jackknife, which leaves out one group of neighbouring frames after the other.
    """
    shape = next(iter(pairs.values())).color.shape
    lags = np.arange(-max_lag, max_lag + 1)
    spectra = {t: (rfft2(pair.color), rfft2(pair.depth)) for t, pair in pairs.items()}
    sums = np.stack([_summed(part.tolist(), spectra, lags) for part in np.array_split(sorted(pairs), groups)])
    total = sums.sum(axis=0)
    lag, shift_px = _best(total, lags, shape, reach_px)
    height, _ = _peak(irfft2(total[np.abs(lags - lag).argmin()], s=shape), reach_px)
    height_as_is, _ = _peak(irfft2(total[max_lag], s=shape), reach_px, within_px=NEARLY_PX)
    without = [_best(total - group, lags, shape, reach_px) for group in sums]
    factor = np.sqrt(groups - 1)
    lag_sigma = factor * np.std([other for other, _ in without])
    shift_sigma_px = factor * np.linalg.norm(np.std([other for _, other in without], axis=0))
    contrast = height / max(height_as_is, 1e-3 * height)
    return Alignment(lag, shift_px, float(lag_sigma), float(shift_sigma_px), contrast)


def _beyond(size: float, sigma: float, least: float) -> float:
    """Probability that a normal variable of that mean and standard deviation is larger than `least`."""
    return float(ndtr((size - least) / max(sigma, 1e-6)))


def _summed(
    part: Sequence[int], spectra: Mapping[int, tuple[Spectrum, Spectrum]], lags: Int64[np.ndarray, " lags"]
) -> Complex64[np.ndarray, "lags rows half"]:
    """Spectra of the correlations of some colour images with the depth images of each lag, summed."""
    total = np.zeros((len(lags), *next(iter(spectra.values()))[0].shape), np.complex64)
    for row, lag in enumerate(lags.tolist()):
        for t in part:
            if t + lag in spectra:
                total[row] += spectra[t][0] * np.conj(spectra[t + lag][1])
    return total


def _best(
    summed: Complex64[np.ndarray, "lags rows half"],
    lags: Int64[np.ndarray, " lags"],
    shape: tuple[int, ...],
    reach_px: float,
) -> tuple[float, Float64[np.ndarray, "2"]]:
    """The lag with the highest peak, refined by a parabola through its neighbours, and the peak's place."""
    peaks = [_peak(irfft2(spectrum, s=shape), reach_px) for spectrum in summed]
    heights = [height for height, _ in peaks]
    best = int(np.argmax(heights))
    inner = 0 < best < len(lags) - 1
    return float(lags[best]) + (_vertex(*heights[best - 1 : best + 2]) if inner else 0.0), peaks[best][1]


def _peak(
    correlation: Float[np.ndarray, "rows columns"], reach_px: float, *, within_px: float | None = None
) -> tuple[float, Float64[np.ndarray, "2"]]:
    """The highest peak with a shift up to `within_px` (`reach_px` when left out), and its place.

    Its height is above the mean of all shifts within `reach_px`, in their standard deviations.
    """
    reach = int(reach_px / STEP_PX)
    around = np.roll(correlation, (reach, reach), axis=(0, 1))[: 2 * reach + 1, : 2 * reach + 1]
    inner = reach if within_px is None else int(within_px / STEP_PX)
    near = around[reach - inner : reach + inner + 1, reach - inner : reach + inner + 1]
    y, x = np.unravel_index(int(near.argmax()), near.shape)
    du = _vertex(*near[y, x - 1 : x + 2].tolist()) if 0 < x < near.shape[1] - 1 else 0.0
    dv = _vertex(*near[y - 1 : y + 2, x].tolist()) if 0 < y < near.shape[0] - 1 else 0.0
    spread = float(around.std())
    height = float(near[y, x] - around.mean()) / spread if spread > 0 else 0.0
    return height, np.array([x - inner + du, y - inner + dv]) * STEP_PX


def _vertex(before: float, at: float, after: float) -> float:
    """Offset of the top of the parabola through three values, -0.5 to 0.5."""
    bend = before - 2 * at + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0


def _color_edges(color: ColorImage) -> Edges:
    """Gradients against their surroundings: a sharp print must not outweigh an outline."""
    grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    small = cv2.resize(grey, None, fx=1 / STEP_PX, fy=1 / STEP_PX, interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(small.astype(np.float32), (0, 0), 1.0)
    gradient = np.hypot(cv2.Scharr(smooth, cv2.CV_32F, 1, 0), cv2.Scharr(smooth, cv2.CV_32F, 0, 1))
    strength = np.sqrt(gradient)
    return _without_mean(strength / (cv2.blur(strength, (SURROUNDINGS, SURROUNDINGS)) + 5))


def _depth_edges(depth_m: DepthImage, *, step: float = 0.03, hole_px: int = 12) -> Edges:
    """1 on the near side of a step of depth, where it was measured; holes count as far surface."""
    small = depth_m[::STEP_PX, ::STEP_PX]
    reach = np.ones((hole_px // STEP_PX * 2 + 1,) * 2, np.uint8)
    filled = np.where(small > 0, small, cv2.dilate(small, reach))
    farthest = cv2.dilate(filled, np.ones((3, 3), np.uint8))
    edges = ((small > 0) & (farthest > small * (1 + step))).astype(np.float32)
    return _without_mean(cv2.GaussianBlur(edges, (3, 3), 0))


def _without_mean(image: Edges) -> Edges:
    """The image less its surroundings, fading towards the border, where a circular shift would wrap."""
    flat = image - cv2.blur(image, (SURROUNDINGS, SURROUNDINGS))
    window = np.outer(np.hanning(image.shape[0]), np.hanning(image.shape[1])) ** 0.25
    return (flat * window).astype(np.float32)
