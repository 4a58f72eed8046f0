"""The object frame of a solution: the axes of its first scene, at the centroid of its keypoints."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.geometry import invert, rigid, transform
from rpl_data.solve.bundle_adjustment import State


class ObjectFrame(NamedTuple):
    """Where the object frame lies, and the keypoints in it.

    Attributes:
        model_from_object: the object frame in the frame of the unknowns.
        points_object: NaN for keypoints without a position.
    """

    model_from_object: Float64[np.ndarray, "4 4"]
    points_object: Float64[np.ndarray, "k 3"]


def object_frame(state: State, known: Bool[np.ndarray, " k"]) -> ObjectFrame:
    """The object frame of an answer.

    Args:
        known: keypoints that have a position; the origin is their centroid.
    """
    in_first = transform(state.scene_from_model[0], state.points_model)
    first_from_object = rigid(np.eye(3), in_first[known].mean(axis=0))
    model_from_object = invert(state.scene_from_model[0]) @ first_from_object
    points = np.where(known[:, None], transform(invert(first_from_object), in_first), np.nan)
    return ObjectFrame(model_from_object, points)
