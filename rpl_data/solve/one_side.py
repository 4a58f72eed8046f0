"""Keypoints that all clicks see from one side: how far away they are, the depth camera alone tells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int64

from rpl_data.solve.diagnosis import Placed, not_followed
from rpl_data.solve.noise import directions_in_model
from rpl_data.wording import counted

ONE_SIDE_RAD = np.deg2rad(15.0)
"""Rays nearer to one another than this hardly tell depth: two clicks of 2 px at 0.6 m leave 11 mm open, while
depth at a corner is stated to 5-10 mm."""
MOST_NAMED = 4
"""Of more keypoints the number is said."""


def one_sided(placed: Placed) -> list[int]:
    """Keypoints that are seen from one side only by the clicks that have a say in the answer."""
    rays = placed.rays.of(~not_followed(placed))
    measured = np.isfinite(rays.depths_m[:, 0])
    return seen_from_one_side(rays.keypoint, directions_in_model(rays, placed.state), measured, placed.known)


def seen_from_one_side(
    keypoint: Int64[np.ndarray, " m"],
    directions: Float64[np.ndarray, "m 3"],
    measured: Bool[np.ndarray, " m"],
    known: Bool[np.ndarray, " k"],
) -> list[int]:
    """Keypoints with clicks in several views, all of them from one side, and with a depth in some.

    Args:
        directions: unit vectors along the clicked rays, in a frame that does not move with respect to the
            object.
        measured: clicks with a depth. Where a keypoint has none, rays alone tell its distance, and its stated
            error holds.
    """
    found = []
    for k in np.flatnonzero(known):
        own = directions[keypoint == k]
        if (
            len(own) > 1
            and measured[keypoint == k].any()
            and float((own @ own.T).min()) > np.cos(ONE_SIDE_RAD)
        ):
            found.append(int(k))
    return found


def describe_one_side(keypoints: Sequence[str], found: Sequence[int]) -> tuple[str, ...]:
    """One line about these keypoints; none without any."""
    if not found:
        return ()
    who = f"keypoint{'s' * (len(found) > 1)} {', '.join(keypoints[k] for k in found)}"
    if len(found) > MOST_NAMED:
        who = f"{len(found)} of {counted(len(keypoints), 'keypoint')}"
    return (
        f"{who} marked from one side only (views within {np.rad2deg(ONE_SIDE_RAD):.0f} degrees): nothing but "
        "the depth camera tells how far away that is; at some corners a real one is off by centimetres, "
        "alike in all these views, which no stated error holds; mark them from another side, too",
    )
