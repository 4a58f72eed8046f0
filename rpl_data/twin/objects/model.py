"""What every object of a twin has: a textured surface, and landmarks ordered so that any few are spread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from rpl_data.twin.surfaces import Surface
from rpl_data.types import DataError, KeypointModel

FEWEST = 3
"""Number of landmarks that a pose needs."""


@dataclass(frozen=True)
class TwinObject:
    """An object with exact ground truth; its frame's origin is the centroid of the landmarks.

    Attributes:
        surface: triangles in the object frame.
        model: the landmarks, on corners and edges, in the object frame; the first few are always well spread
            (see `spread_order`).
    """

    surface: Surface
    model: KeypointModel

    def renamed(self, name: str) -> TwinObject:
        """Return the same object under another name."""
        return replace(self, model=replace(self.model, name=name))


def assembled(
    name: str,
    surface: Surface,
    landmarks: Mapping[str, Sequence[float]],
    lines: Sequence[tuple[str, str]] = (),
) -> TwinObject:
    """Make an object with its landmarks in `spread_order` and its origin at their centroid.

    Args:
        lines: pairs of landmarks to draw a line between.
    """
    points = np.array(list(landmarks.values()), dtype=float)
    order = spread_order(points)
    names = [list(landmarks)[number] for number in order]
    centre = points.mean(axis=0)
    skeleton = tuple((names.index(a), names.index(b)) for a, b in lines)
    model = KeypointModel(name, tuple(names), points[order] - centre, skeleton)
    return TwinObject(replace(surface, vertices=surface.vertices - centre), model)


def with_landmarks(one: TwinObject, count: int) -> TwinObject:
    """Return the object with only its first landmarks, its origin moved to their centroid.

    Raises:
        DataError: `count` is less than three or more than the object has.
    """
    model, have = one.model, len(one.model.keypoints)
    if not FEWEST <= count <= have:
        raise DataError(
            f"twin object {model.name} has {have} landmarks; ask for {FEWEST} to {have}, not {count}"
        )
    points = model.points_object[:count]
    centre = points.mean(axis=0)
    lines = tuple(pair for pair in model.skeleton if max(pair) < count)
    fewer = KeypointModel(model.name, model.keypoints[:count], points - centre, lines)
    return TwinObject(replace(one.surface, vertices=one.surface.vertices - centre), fewer)


def spread_order(points: Float64[np.ndarray, "n 3"]) -> list[int]:
    """Order the points so that the first few of them are always well spread.

    Farthest-point order (Gonzalez, Theoretical Computer Science 38, 1985) from the point farthest from
    centroid. But the third is the one farthest from the line through the first two, and the fourth the one
    farthest from the plane through the first three, so that few landmarks fix a pose well too.
    """
    order = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    while len(order) < len(points):
        away = _distance(points, points[order])
        away[order] = -1.0
        order.append(int(np.argmax(away)))
    return order


def _distance(
    points: Float64[np.ndarray, "n 3"], chosen: Float64[np.ndarray, "m 3"]
) -> Float64[np.ndarray, " n"]:
    """Distance to the nearest chosen point; to the line through two, to the plane through three."""
    if len(chosen) not in (2, 3):
        apart: Float64[np.ndarray, " n"] = np.linalg.norm(points[:, None] - chosen[None], axis=-1).min(axis=1)
        return apart
    basis = np.linalg.svd(chosen[1:] - chosen[0])[2][: len(chosen) - 1]
    offset = points - chosen[0]
    off: Float64[np.ndarray, " n"] = np.linalg.norm(offset - offset @ basis.T @ basis, axis=1)
    return off
