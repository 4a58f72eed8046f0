"""Make camera paths drift as every odometry does: slowly, smoothly and without returning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from rpl_data.types import DataError


@dataclass(frozen=True)
class Drift:
    """Error of a path's last pose (root mean square over many paths).

    Attributes:
        metres: error of the camera's position.
        degrees: error of its orientation.
        smooth_s: changes of the error faster than this are smoothed away.
    """

    metres: float = 0.005
    degrees: float = 0.3
    smooth_s: float = 1.0

    def __post_init__(self) -> None:
        """Refuse negative values."""
        if self.metres < 0 or self.degrees < 0 or self.smooth_s < 0:
            raise DataError(f"the values of a drift must not be negative; got {self}")


def drifted(
    scene_from_camera: Float64[np.ndarray, "n 4 4"],
    times_s: Float64[np.ndarray, " n"],
    drift: Drift,
    *,
    rng: np.random.Generator,
) -> Float64[np.ndarray, "n 4 4"]:
    """Return the path with drift; each error is in its own camera's frame, and the first pose is exact.

    The error is a random walk of position and orientation with smoothed steps, so it grows with the
    square root of time, and neighbouring frames agree.
    """
    count = len(times_s)
    if count < 2:
        return scene_from_camera.copy()
    walk = _walk(rng, count, window=_window(times_s, drift.smooth_s))
    error = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
    error[:, :3, :3] = Rotation.from_rotvec(np.deg2rad(drift.degrees) / np.sqrt(3) * walk[:, :3]).as_matrix()
    error[:, :3, 3] = drift.metres / np.sqrt(3) * walk[:, 3:]
    poses: Float64[np.ndarray, "n 4 4"] = scene_from_camera @ error
    return poses


def _window(times_s: Float64[np.ndarray, " n"], smooth_s: float) -> Float64[np.ndarray, " m"]:
    """Weights of the smoothing filter, which sum to one; it is not longer than the path."""
    period_s = float(np.median(np.diff(times_s)))
    length = int(np.clip(round(smooth_s / max(period_s, 1e-6)), 1, len(times_s)))
    weights = np.hanning(length + 2)[1:-1]
    normalised: Float64[np.ndarray, " m"] = weights / weights.sum()
    return normalised


def _walk(
    rng: np.random.Generator, count: int, *, window: Float64[np.ndarray, " m"]
) -> Float64[np.ndarray, "count 6"]:
    """Draw six random walks from 0 whose last values have unit variance."""
    steps = rng.standard_normal((count - 1 + len(window) - 1, 6))
    smooth = np.stack([np.convolve(column, window, mode="valid") for column in steps.T], axis=1)
    walk = np.vstack([np.zeros(6), np.cumsum(smooth, axis=0)])
    # The last value is the sum of all steps, each weighted by how many windows contain it.
    counted = np.convolve(np.ones(count - 1), window, mode="full")
    unit: Float64[np.ndarray, "count 6"] = walk / np.sqrt((counted**2).sum())
    return unit
