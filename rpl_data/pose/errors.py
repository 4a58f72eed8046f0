"""Measure how wrong a pose is: the paper's two numbers, ADD and ADD-S."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.spatial import cKDTree

from rpl_data.geometry import Points, Transform, rotation_angle_rad, transform


@dataclass(frozen=True)
class PoseErrors:
    """Errors of one estimate relative to the true pose.

    Attributes:
        position_m: distance of the model's centre from its true position.
        orientation_rad: geodesic angle, ``||log(R1^T R2)||_F / sqrt(2)`` (section IV-C of the paper).
        add_m: mean distance of the model's points from their true positions (Hinterstoisser et al., ACCV
            2012).
        adds_m: mean distance of the true model's points from the nearest point of the estimated one (same
            source); for objects that look the same from several sides.
    """

    position_m: float
    orientation_rad: float
    add_m: float
    adds_m: float


INFINITE = PoseErrors(np.inf, np.inf, np.inf, np.inf)
"""Of a failure. Half a turn, the largest angle there is, would be a figure that can be compared."""


def pose_errors(
    estimated: Transform, true: Transform, points_object: Points, *, centre_object: Float64[np.ndarray, "3"]
) -> PoseErrors:
    """Measure the errors of a pose ``camera_from_object``.

    Args:
        estimated: the estimate.
        true: the true pose.
        points_object: points of the model's surface, metres; a thousand are enough.
        centre_object: point whose position is compared: the centre of the CAD model.
    """
    here, there = transform(estimated, points_object), transform(true, points_object)
    off = transform(estimated, centre_object) - transform(true, centre_object)
    return PoseErrors(
        position_m=float(np.linalg.norm(off)),
        orientation_rad=rotation_angle_rad(estimated[:3, :3].T @ true[:3, :3]),
        add_m=float(np.linalg.norm(here - there, axis=1).mean()),
        adds_m=float(cKDTree(here).query(there)[0].mean()),
    )
