"""How far training crops should turn, by how differently the object lies in its scenes."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Float64

SIDE_DEG = 45.0
"""An object whose upward axis differs by more than this lies on another side: neighbouring sides of a box
are 90 deg apart, and this is halfway."""

ANY_TURN_DEG = 180.0
USUAL_TURN_DEG = 30.0

PRIOR = 0.02
"""Weight of the images' upward axis against the horizontal ones of all frames."""


def turn_by_places(places: np.ndarray, camera_from_object: Float64[np.ndarray, "n 4 4"]) -> float:
    """Return 180 deg where the object lies on different sides in different places, else 30 deg.

    A place is a scene, or one of the instances in it.

    A camera held upright sees an object that always stands on the same side upright, too, and turning its
    crops only makes the task harder. Where the object lies on other sides in other scenes, a scene nobody
    trained on may show any side up, so any turn is to be expected.
    """
    ups = [up_in_object(camera_from_object[places == place]) for place in np.unique(places)]
    angles = [np.rad2deg(np.arccos(np.clip(a @ b, -1, 1))) for a, b in combinations(ups, 2)]
    return ANY_TURN_DEG if max(angles, default=0.0) > SIDE_DEG else USUAL_TURN_DEG


def up_in_object(camera_from_object: Float64[np.ndarray, "n 4 4"]) -> Float64[np.ndarray, "3"]:
    """Estimate the direction against gravity in the object's frame, from one scene.

    The x axis of a camera held upright is level in every frame. So the direction that is most nearly
    perpendicular to all of them is vertical; where they are all alike, the images' own upward axis decides.
    """
    levels, ups = camera_from_object[:, 0, :3], -camera_from_object[:, 1, :3]
    mean = ups.mean(axis=0)
    mean /= np.linalg.norm(mean)
    moments = levels.T @ levels / len(levels) + PRIOR * (np.eye(3) - np.outer(mean, mean))
    up: Float64[np.ndarray, "3"] = np.linalg.eigh(moments)[1][:, 0]
    return up if up @ mean >= 0 else -up
