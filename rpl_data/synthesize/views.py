"""From which side, and how turned, an object is shown."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.directions import COMPARED, Directions, gaps_deg, nearest_spread, spread_directions
from rpl_data.synthesize.body import Body
from rpl_data.synthesize.turning import cross, shortest_turn, turn_about

MOST_UNSEEN = 0.05
"""Share of an object's pixels that may show what no camera saw."""
STANDING = 0.5
"""Share of the views in which an object stands as it did in a scene, turned about the vertical; in the
others it is shown from sides that the recordings lack, however it would have to lie for that."""
GAP_DEG = 45.0
"""A direction this far from all recorded views is `1 + LACKING` times as likely as a recorded one."""
LACKING = 4.0
LOOKED_AT = 24
"""Rays along each axis by which a direction is judged."""
AT_ONCE = 20
"""Parts in which directions are judged, to spare memory."""

Rotated = Float64[np.ndarray, "3 3"]


def shown_directions(body: Body) -> Bool[np.ndarray, " d"]:
    """Which of `spread_directions(COMPARED)` show the mesh without what no camera saw, from far away."""
    vertices = body.painted.vertices
    centre = vertices.mean(axis=0)
    reach_m = float(np.linalg.norm(vertices - centre, axis=1).max())
    side = np.linspace(-reach_m, reach_m, LOOKED_AT)
    across, down = (axis.reshape(1, -1, 1) for axis in np.meshgrid(side, side))
    found = []
    for directions in np.array_split(spread_directions(COMPARED), AT_ONCE):
        first, second = (axis[:, None] for axis in _across(directions))
        start = centre + 2 * reach_m * directions[:, None] + across * first + down * second
        way = np.broadcast_to(-directions[:, None], start.shape)
        hits = body.rays.cast(np.concatenate([start, way], axis=2).reshape(-1, 6).astype(np.float32))
        hit = np.isfinite(hits.t)
        inside_out = np.einsum("nd,nd->n", hits.normals, -way.reshape(-1, 3)) < 0
        unseen = hit & (inside_out | ~body.painted.seen[hits.triangle_id])
        hit, unseen = (one.reshape(len(directions), -1).sum(axis=1) for one in (hit, unseen))
        found.append((hit > 0) & (unseen <= MOST_UNSEEN * hit))
    return np.concatenate(found)


def view_weights(views: Directions, shown: Bool[np.ndarray, " d"]) -> Float64[np.ndarray, " d"]:
    """How likely each of the directions is: the more, the farther it is from what was recorded; sum 1."""
    weights = (1 + LACKING * np.minimum(gaps_deg(views) / GAP_DEG, 1)) * shown
    total: float = weights.sum()
    return np.asarray(weights / total if total > 0 else weights)


def is_shown(direction: Float64[np.ndarray, "3"], shown: Bool[np.ndarray, " d"]) -> bool:
    """Whether the nearest of the directions is one of those that are shown."""
    return bool(shown[nearest_spread(len(shown), direction)])


def looking(
    view: Float64[np.ndarray, "3"],
    up: Float64[np.ndarray, "3"],
    ray: Float64[np.ndarray, "3"],
    turn_rad: float,
) -> Rotated:
    """The rotation `camera_from_object` that shows an object from one side.

    Args:
        view: from the object to the camera, object frame.
        up: what is up in the image before it is turned, object frame.
        ray: from the camera to the object, camera frame.
        turn_rad: turn of the image about the ray.
    """
    in_camera = _axes(-ray, np.array([0.0, -1.0, 0.0]))
    in_object = _axes(view, up)
    turned = turn_about(ray / np.linalg.norm(ray), turn_rad)
    rotation: Rotated = turned @ in_camera @ in_object.T
    return rotation


def standing(
    up_object: Float64[np.ndarray, "3"], up_camera: Float64[np.ndarray, "3"], turn_rad: float
) -> Rotated:
    """The rotation `camera_from_object` of an object that stands on a table, turned about the vertical."""
    rotation: Rotated = turn_about(up_camera, turn_rad) @ shortest_turn(up_object, up_camera)
    return rotation


def _axes(forward: Float64[np.ndarray, "3"], up: Float64[np.ndarray, "3"]) -> Rotated:
    """Columns: an orthonormal frame whose third axis is `forward` and whose second is nearest to `up`."""
    third = forward / np.linalg.norm(forward)
    second = up - (up @ third) * third
    if np.linalg.norm(second) < 1e-6:
        second = _across(third)[0]
    second = second / np.linalg.norm(second)
    return np.column_stack([cross(second, third), second, third])


def _across(direction: Float64[np.ndarray, "*n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors at right angles to each direction and to one another."""
    first = np.cross(np.eye(3)[np.abs(direction).argmin(axis=-1)], direction)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return first, np.cross(direction, first)
