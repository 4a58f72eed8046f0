"""Clicks of one frame share the error of that frame's pose where the camera's path strays.

Each frame of a straying scene is off by its own shift, of the same standard deviation for all frames.
Eliminating the shifts (generalised least squares) leaves residuals that are independent again. Without that,
rays from two frames that stray by a few millimetres would intersect, confidently, centimetres from the
keypoint.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64


class Whitened(NamedTuple):
    """Residuals of every click, and derivatives, freed of what the clicks of a frame share.

    Attributes:
        relief: by how much the shifts lower the sum of the squares.
    """

    residual: Float64[np.ndarray, "m 3"]
    jacobian: Float64[np.ndarray, "m 3 u"]
    relief: float


class Shared(NamedTuple):
    """What the clicks of a frame share.

    Attributes:
        clicks: their numbers.
        along: orthonormal columns of their residuals, three per click one after another.
        relieved: what share of the squares along each column the frame's shift explains.
    """

    clicks: Int64[np.ndarray, " n"]
    along: Float64[np.ndarray, "r 3"]
    relieved: Float64[np.ndarray, "3"]


def without_straying(
    residual: Float64[np.ndarray, "m 3"],
    jacobian: Float64[np.ndarray, "m 3 u"],
    by_shift: Float64[np.ndarray, "m 3 3"],
    strayed_m: Float64[np.ndarray, " m"],
    frame: Int64[np.ndarray, " m"],
) -> Whitened:
    """Whiten weighted residuals whose covariance is 1 + s^2 B B' within each frame.

    Args:
        by_shift: derivative of the residuals by a shift of the scene (B).
        strayed_m: standard deviation of a frame's shift, per axis (s); 0 where the poses hold.
        frame: numbers that tell the frames of all scenes apart.
    """
    residual, jacobian, relief = residual.copy(), jacobian.copy(), 0.0
    for own, along, relieved in shared_by_frames(by_shift, strayed_m, frame):
        lost = 1 - np.sqrt(1 - relieved)
        errors, slopes = residual[own].reshape(-1), jacobian[own].reshape(len(along), -1)
        relief += float(relieved @ (along.T @ errors) ** 2)
        residual[own] = (errors - along @ (lost * (along.T @ errors))).reshape(-1, 3)
        jacobian[own] = (slopes - along @ (lost[:, None] * (along.T @ slopes))).reshape(jacobian[own].shape)
    return Whitened(residual, jacobian, relief)


def shared_by_frames(
    by_shift: Float64[np.ndarray, "m 3 3"],
    strayed_m: Float64[np.ndarray, " m"],
    frame: Int64[np.ndarray, " m"],
) -> Iterator[Shared]:
    """What a shift of each straying frame would do to the weighted residuals of its clicks.

    Args:
        by_shift, strayed_m, frame: as for `without_straying`.
    """
    for number in np.unique(frame[strayed_m > 0]):
        own = np.flatnonzero(frame == number)
        shift = by_shift[own].reshape(-1, 3)
        information, axes = np.linalg.eigh(shift.T @ shift)
        information = np.maximum(information, 1e-9)  # per m^2; a click alone tells nothing along its ray
        variance = strayed_m[own[0]] ** 2 * information
        yield Shared(own, shift @ axes / np.sqrt(information), variance / (1 + variance))
