"""Depths that err together: what clicks on one keypoint have in common when they see it from the same side.

A depth camera rounds corners, widens edges and loses faces that it sees at a grazing angle. What it does to a
keypoint depends on the side from which it looks, and hardly on the frame or the scene: two clicks from the
same side are wrong alike, and more of them do not average the error away. In nearly the same view the error
is all but the same: on a real desk the correlation is 0.9 for views 1 degree apart, 0.75 at 2-7, 0.6-0.7 at 9
and 0.5 at 12, within a scene and between scenes. On rendered objects it is 0.6 at 5 degrees, 0.5 at 10 to 25
and 0.35 at 40 within a scene, half of that between scenes.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int64

SHARED_VARIANCE = 0.5
"""Share of a depth's variance that two clicks on one keypoint from the same side have in common."""
SAME_SIDE_RAD = np.deg2rad(25.0)
"""Two views this far apart still share exp(-1/2) of that."""
SAME_VIEW_VARIANCE = 0.4
"""What two clicks have in common besides where their views are nearly the same."""
SAME_VIEW_RAD = np.deg2rad(5.0)
"""Two views this far apart still share exp(-1/2) of that."""


def shared_errors(
    keypoint: Int64[np.ndarray, " m"],
    directions: Float64[np.ndarray, "m 3"],
    together: Bool[np.ndarray, "m m"] | None = None,
) -> Float64[np.ndarray, "m m"]:
    """Correlation of the depth errors of M clicks, each with its keypoint and the direction it is seen along.

    Args:
        directions: unit vectors in a frame that does not move with respect to the object.
        together: pairs of clicks that may share anything; all when None.
    """
    apart = 2 - 2 * np.clip(directions @ directions.T, -1, 1)  # squared chords: about the angle squared
    alike = (
        (keypoint[:, None] == keypoint) if together is None else (keypoint[:, None] == keypoint) & together
    )
    shared = np.where(alike, _correlation(apart), 0.0)
    np.fill_diagonal(shared, 1.0)
    return shared


def widening(
    scene: Int64[np.ndarray, " m"],
    keypoint: Int64[np.ndarray, " m"],
    directions_scene: Float64[np.ndarray, "m 3"],
    measured: Bool[np.ndarray, " m"],
) -> Float64[np.ndarray, " m"]:
    """By how much to widen each depth's deviation, so that n depths that err together weigh as they should.

    The mean of n errors of variance 1 and correlation r has the variance (1 + (n - 1) r) / n; n independent
    errors of variance 1 + (n - 1) r have the same. Only clicks of one scene are looked at, in which the
    directions are known before the object's pose is.

    Args:
        measured: clicks with a depth; the others have no error to share.
    """
    together = (scene[:, None] == scene) & both(measured)
    widened: Float64[np.ndarray, " m"] = np.sqrt(
        shared_errors(keypoint, directions_scene, together).sum(axis=1)
    )
    return widened


def both(measured: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, "m m"]:
    """Pairs of clicks that both have a depth."""
    pairs: Bool[np.ndarray, "m m"] = measured[:, None] & measured
    return pairs


def _correlation(apart: Float64[np.ndarray, "m m"]) -> Float64[np.ndarray, "m m"]:
    """Of the depth errors of two clicks whose views are so far apart, in squared radians."""
    side = SHARED_VARIANCE * np.exp(-apart / (2 * SAME_SIDE_RAD**2))
    view = SAME_VIEW_VARIANCE * np.exp(-apart / (2 * SAME_VIEW_RAD**2))
    correlation: Float64[np.ndarray, "m m"] = side + view
    return correlation
