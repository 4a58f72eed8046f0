"""Compare depth edges with colour edges: the lag and registration of the two cameras, from images alone.

An object's outline is an edge in both images. The depth edges of frame t + lag are correlated with the
colour edges of frame t over all shifts, and the correlations are summed over the frames: an error that all
frames share (a shift, a lag, another field of view) adds up, everything else averages out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Complex64, Float, Float64, Int64
from scipy.fft import irfft2, rfft2
from scipy.special import ndtr

from rpl_data.doctor.edges import STEP_PX, Edges, FrameEdges

NEARLY_PX = 6.0
"""Uncertainty of depth edges; a registration error below this cannot be seen."""

ZOOMS = np.geomspace(1 / 1.7, 1.7, 27)
"""Zooms that are tried, in steps of 4 %. Unregistered, a Kinect has 0.9, a D435 at 640 x 480 has 1.6."""

ZOOM_PEAK_RATIO = 1.2
"""A zoom's peak must be this many times higher than without zoom, and than at every zoom not near it."""

EVERY_FOR_ZOOM = 3
"""A zoom is first sought in every third frame; only where another than 1 is highest are all frames used."""

NEAR_ZOOM = 1.12
"""Zooms within this factor count as near. A true zoom is sharp: at this factor, edges halfway to the sides
are 10 px off. Where edges are few and close together, zoom and shift look the same and the peak is flat."""

Spectrum = Complex64[np.ndarray, "rows half"]


@dataclass(frozen=True)
class Alignment:
    """The lag, zoom and shift at which colour and depth edges match best.

    Attributes:
        lag_frames: depth images are this many frames late.
        zoom: to match the colour images at that lag, depth images must be enlarged by this about their centre
        shift_px: and then moved by this (u, v).
        lag_sigma, zoom_sigma, shift_sigma_px: standard errors by the jackknife (Efron and Stein, 1981);
            large when there are too few edges to tell.
        lag_contrast, shift_contrast: height of the peak relative to that of unchanged images (no lag, no
            zoom, almost no shift), and relative to that at the same lag; 1 when they are the same peak. Print
            along an object's edges can make a second peak just as high.
        near: heights of the peaks within `NEARLY_PX` of no shift: one column per lag, one row per group
            that was left out.
    """

    lag_frames: float
    zoom: float
    shift_px: Float64[np.ndarray, "2"]
    lag_sigma: float
    zoom_sigma: float
    shift_sigma_px: float
    lag_contrast: float
    shift_contrast: float
    near: Float64[np.ndarray, "groups lags"]

    def prefers(self, lag: int) -> float:
        """Probability that edges match better at this lag than at no lag, when images are not shifted.

        Choosing between two lags needs fewer edges than searching for the lag. 0.5 for a lag that was not
        tried.
        """
        middle = self.near.shape[1] // 2
        if not 0 < abs(lag) <= middle:
            return 0.5
        better = self.near[:, middle + lag] - self.near[:, middle]
        return _beyond(float(better.mean()), float(np.sqrt(len(better) - 1) * better.std()), 0.0)

    def sure_of_lag(self, least_frames: float) -> float:
        """Probability that the absolute lag is larger than `least_frames`."""
        return _beyond(abs(self.lag_frames), self.lag_sigma, least_frames)

    def sure_of_zoom(self, least: float) -> float:
        """Probability that the zoom differs from 1 by more than `least`."""
        return _beyond(abs(self.zoom - 1), self.zoom_sigma, least)

    def sure_of_shift(self, least_px: float) -> float:
        """Probability that the shift is longer than `least_px`."""
        return _beyond(float(np.linalg.norm(self.shift_px)), self.shift_sigma_px, least_px)


def align(
    pairs: Mapping[int, FrameEdges], *, max_lag: int = 5, reach_px: float = 40.0, groups: int = 8
) -> Alignment:
    """Correlate the depth edges of frame t + lag with the colour edges of frame t, summed over all t.

    The lag is searched first, then the zoom at that lag. If a zoom makes the edges match, the lag is searched
    again with it.

    Args:
        pairs: edge images, keyed by position in the recording; a frame whose partner is missing is skipped.
        max_lag: lags from -max_lag to max_lag frames are tried.
        reach_px: shifts up to this are tried.
        groups: number of groups of neighbouring frames for the jackknife, which leaves out one at a time.
    """
    lags = np.arange(-max_lag, max_lag + 1)
    spectra = _Spectra.of(pairs, groups)
    plain = spectra.summed(lags, np.ones(len(lags)))
    near = _near(plain, spectra.shape, reach_px)
    by_lag = _best(lags.astype(float), plain, spectra.shape, reach_px)
    if not by_lag.height > 0:  # one of the two has no edges: nothing was measured
        return Alignment(0.0, 1.0, np.zeros(2), np.inf, np.inf, np.inf, 1.0, 1.0, near)
    lag = round(by_lag.value) if by_lag.sigma < 0.5 else 0
    by_zoom = _zoom(spectra, lag, by_lag, reach_px)
    if by_zoom is not None:
        summed = spectra.summed(lags, np.full(len(lags), by_zoom.value))
        by_lag = _best(lags.astype(float), summed, spectra.shape, reach_px)
    as_is = near.mean(axis=0)
    return Alignment(
        lag_frames=by_lag.value,
        zoom=1.0 if by_zoom is None else by_zoom.value,
        shift_px=by_lag.shift_px,
        lag_sigma=by_lag.sigma,
        zoom_sigma=0.0 if by_zoom is None else by_zoom.sigma,
        shift_sigma_px=by_lag.shift_sigma_px,
        lag_contrast=by_lag.height / max(as_is[max_lag], 1e-3 * by_lag.height),
        shift_contrast=by_lag.height / max(as_is[max_lag + round(by_lag.value)], 1e-3 * by_lag.height),
        near=near,
    )


def _zoom(spectra: _Spectra, lag: int, by_lag: _Best, reach_px: float) -> _Best | None:
    """The zoom at which edges match much better than as they are, and than at every zoom not near it."""
    few, lags = spectra.thinned(EVERY_FOR_ZOOM, lag), np.full(len(ZOOMS), lag)
    at_first, _, _ = _highest(ZOOMS, few.summed(lags, ZOOMS).sum(axis=0), spectra.shape, reach_px)
    if abs(np.log(at_first)) < np.log(ZOOMS[1] / ZOOMS[0]) / 2:
        return None
    found = _best(ZOOMS, spectra.summed(lags, ZOOMS), spectra.shape, reach_px)
    as_it_is = max(by_lag.height, found.elsewhere(NEAR_ZOOM))
    return found if found.height > ZOOM_PEAK_RATIO * as_it_is else None


def _beyond(size: float, sigma: float, least: float) -> float:
    """Probability that a normal variable of mean `size` and standard deviation `sigma` exceeds `least`."""
    return float(ndtr((size - least) / max(sigma, 1e-6)))


Summed = Complex64[np.ndarray, "groups tried rows half"]
"""Spectra of the correlations, summed per group of frames, for each lag or zoom that is tried."""


@dataclass(frozen=True)
class _Spectra:
    """The edges of all frames, ready to be correlated.

    Attributes:
        color: Fourier transforms of the colour edges, by position in the recording.
        depth: depth edges by position; transformed once their zoom is known.
        groups: positions of neighbouring frames, per jackknife group.
        shape: rows and columns of the edge images.
    """

    color: Mapping[int, Spectrum]
    depth: Mapping[int, Edges]
    groups: tuple[tuple[int, ...], ...]
    shape: tuple[int, int]

    @staticmethod
    def of(pairs: Mapping[int, FrameEdges], groups: int) -> _Spectra:
        height, width = next(iter(pairs.values())).color.shape
        return _Spectra(
            {t: rfft2(pair.color) for t, pair in pairs.items()},
            {t: pair.depth for t, pair in pairs.items()},
            tuple(tuple(part.tolist()) for part in np.array_split(sorted(pairs), groups)),
            (height, width),
        )

    def thinned(self, every: int, lag: int) -> _Spectra:
        """One of `every` frames, with the depth that belongs to it at this lag."""
        groups = tuple(group[::every] for group in self.groups)
        kept = {t + lag for group in groups for t in group}
        return replace(self, depth={t: edges for t, edges in self.depth.items() if t in kept}, groups=groups)

    def summed(self, lags: Int64[np.ndarray, " tried"], zooms: Float64[np.ndarray, " tried"]) -> Summed:
        """Correlate colour of frame t with zoomed depth of frame t + lag, for each lag and zoom."""
        result = np.zeros((len(self.groups), len(lags), *next(iter(self.color.values())).shape), np.complex64)
        for zoom in np.unique(zooms).tolist():
            depth = {t: rfft2(_zoomed(edges, zoom)) for t, edges in self.depth.items()}
            for column in np.flatnonzero(zooms == zoom).tolist():
                for row, group in enumerate(self.groups):
                    for t in group:
                        if t + lags[column] in depth:
                            result[row, column] += self.color[t] * np.conj(depth[t + int(lags[column])])
        return result


def _zoomed(edges: Edges, zoom: float) -> Edges:
    """Enlarge the image about its centre."""
    if zoom == 1:
        return edges
    height, width = edges.shape
    matrix = np.array([[zoom, 0, (1 - zoom) * (width - 1) / 2], [0, zoom, (1 - zoom) * (height - 1) / 2]])
    return cv2.warpAffine(edges, matrix, (width, height)).astype(np.float32)


def _near(summed: Summed, shape: tuple[int, int], reach_px: float) -> Float64[np.ndarray, "groups tried"]:
    """Heights of the peaks near no shift, for everything tried, leaving out one group at a time."""
    total = summed.sum(axis=0)
    return np.array(
        [
            [_peak(irfft2(spectrum, s=shape), reach_px, within_px=NEARLY_PX)[0] for spectrum in total - group]
            for group in summed
        ]
    )


@dataclass(frozen=True)
class _Best:
    """The lag or zoom with the highest peak; see `Alignment`.

    Attributes:
        tried, heights: all values that were tried, and the heights of their peaks.
    """

    value: float
    sigma: float
    shift_px: Float64[np.ndarray, "2"]
    shift_sigma_px: float
    height: float
    tried: Float64[np.ndarray, " tried"]
    heights: Float64[np.ndarray, " tried"]

    def elsewhere(self, factor: float) -> float:
        """Highest peak among the values that differ from the best by more than a factor."""
        apart = np.abs(np.log(self.tried / self.value)) > np.log(factor)
        return float(self.heights[apart].max(initial=0.0))


def _best(
    tried: Float64[np.ndarray, " tried"], summed: Summed, shape: tuple[int, int], reach_px: float
) -> _Best:
    """Find the value with the highest peak, and its standard error by leaving out one group at a time."""
    total = summed.sum(axis=0)
    value, shift_px, heights = _highest(tried, total, shape, reach_px)
    without = [_highest(tried, total - group, shape, reach_px) for group in summed]
    factor = np.sqrt(len(summed) - 1)
    sigma = float(factor * np.std([other for other, _, _ in without]))
    shift_sigma_px = float(factor * np.linalg.norm(np.std([other for _, other, _ in without], axis=0)))
    return _Best(value, sigma, shift_px, shift_sigma_px, float(heights.max()), tried, heights)


def _highest(
    tried: Float64[np.ndarray, " tried"],
    total: Complex64[np.ndarray, "tried rows half"],
    shape: tuple[int, int],
    reach_px: float,
) -> tuple[float, Float64[np.ndarray, "2"], Float64[np.ndarray, " tried"]]:
    """Return the value with the highest peak (refined by a parabola), its shift, and all heights."""
    peaks = [_peak(irfft2(spectrum, s=shape), reach_px) for spectrum in total]
    heights = np.array([height for height, _ in peaks], dtype=float)
    best = int(np.argmax(heights))
    inner = 0 < best < len(tried) - 1
    offset = _vertex(*heights[best - 1 : best + 2].tolist()) if inner else 0.0
    return float(np.interp(best + offset, np.arange(len(tried)), tried)), peaks[best][1], heights


def _peak(
    correlation: Float[np.ndarray, "rows columns"], reach_px: float, *, within_px: float | None = None
) -> tuple[float, Float64[np.ndarray, "2"]]:
    """Return the height and position of the highest peak within `within_px` (by default `reach_px`).

    The height is measured from the mean over all shifts within `reach_px`, in standard deviations.
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
    """Offset of the vertex of the parabola through three values, -0.5 to 0.5."""
    bend = before - 2 * at + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0
