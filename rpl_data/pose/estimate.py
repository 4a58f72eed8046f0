"""Estimate an object's pose from its keypoints in one image, and from depth where it is known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.geometry import spread_m
from rpl_data.pose.correspondences import Correspondences
from rpl_data.pose.refine import (
    covariance_of,
    nearest_to_depth,
    refined,
    reprojection_sigmas,
    with_own_depth,
)
from rpl_data.pose.solvers import FEWEST, INLIER_SIGMAS, SOLVERS

Method = Literal["epnp", "sqpnp", "ransac", "consensus"]

Reason = Literal[
    "too few keypoints",
    "keypoints on a line",
    "keypoints in a plane",
    "keypoints coincide",
    "keypoints disagree",
    "not in front",
]

THINNEST = 0.01
"""A point set this thin, relative to its extent, counts as a line or a plane: a plane seen with a few pixels
of noise allows two poses (Schweighofer and Pinz, PAMI 28, 2006), and EPnP is unstable on it."""

COINCIDENT_PX = 1.0
"""Keypoints this near one another in the image count as one position."""

LARGEST_ERROR = 0.5
"""A pose whose reprojection error exceeds this share of the keypoints' spread in the image (both root mean
squares) explains them little better than their mean does."""


@dataclass(frozen=True)
class PoseEstimate:
    """A pose, and how far to trust it.

    Attributes:
        camera_from_object: the pose, metres.
        keypoints: numbers of the keypoints it is based on.
        covariance: 6x6 covariance of a small rotation about the object's origin (rad, camera axes) and a
            translation (metres), in this order; propagated from the covariance of the keypoints.
        error_sigmas: root mean square reprojection error of those keypoints per axis, in their standard
            deviations: about 1 when these are right.
    """

    camera_from_object: Float64[np.ndarray, "4 4"]
    keypoints: Int64[np.ndarray, " n"]
    covariance: Float64[np.ndarray, "6 6"]
    error_sigmas: float


@dataclass(frozen=True)
class PoseFailure:
    """The reason why there is no pose."""

    reason: Reason


def estimate_pose(
    given: Correspondences, *, method: Method = "consensus", refine: bool = True
) -> PoseEstimate | PoseFailure:
    """Estimate ``camera_from_object`` from keypoints, or say why not.

    Keypoints mirrored in the image differ from those of another pose by perspective alone, so from a small or
    distant object they yield a pose like any other; only its `error_sigmas` and its depth can tell.

    Args:
        given: what `correspondences` returned.
        method: `epnp` is the paper's, `sqpnp` is more accurate; both trust every keypoint. `ransac` and
            `consensus` exclude wrong ones.
        refine: refine the pose by Levenberg-Marquardt, weighted by the covariances and with the depths
            (robust if there are any, since depth may belong to what hides the keypoint); the paper does not.
    """
    if (refusal := _refusal(given)) is not None:
        return refusal
    attempt = SOLVERS[method](given)
    if attempt is None or not np.isfinite(attempt[0]).all():
        return PoseFailure("keypoints disagree")
    pose, inliers = attempt
    rest = given if inliers.all() else given.only(inliers)
    if rest is not given and (refusal := _refusal(rest)) is not None:
        return PoseFailure("keypoints disagree") if refusal.reason == "too few keypoints" else refusal
    try:
        if refine:
            deep = bool(np.isfinite(rest.depth_m).any())
            pose = nearest_to_depth(pose, rest) if deep else pose
            pose = refined(pose, rest, robust=deep)
            rest = with_own_depth(pose, rest, largest_sigmas=INLIER_SIGMAS) if deep else rest
        covariance = covariance_of(pose, rest)
    except np.linalg.LinAlgError:  # the keypoints leave a direction of the pose free
        return PoseFailure("keypoints disagree")
    sigmas = reprojection_sigmas(pose[None], rest)[0]
    if not np.isfinite(sigmas).all():
        return PoseFailure("not in front")
    squares, distances = float(sigmas @ sigmas), _distances_sigmas(rest)
    if squares > LARGEST_ERROR**2 * float(distances @ distances):
        return PoseFailure("keypoints disagree")
    return PoseEstimate(pose, rest.keypoints, covariance, math.sqrt(squares / (2 * len(rest))))


def _refusal(given: Correspondences) -> PoseFailure | None:
    """Say why these points, seen at these places, cannot determine a pose."""
    if len(given) < FEWEST:
        return PoseFailure("too few keypoints")
    if _coincide(given):
        return PoseFailure("keypoints coincide")
    length, width, height = spread_m(given.points_object)
    if width <= THINNEST * length:
        return PoseFailure("keypoints on a line")
    return PoseFailure("keypoints in a plane") if height <= THINNEST * length else None


def _coincide(given: Correspondences) -> bool:
    """Whether one point of the image explains all keypoints, or more than half of them are in one place."""
    du, dv = (given.positions_px[:, None] - given.positions_px).T
    crowded = (du * du + dv * dv < COINCIDENT_PX**2).sum(axis=0).max() > len(given) / 2
    return bool(crowded or _distances_sigmas(given).max() < INLIER_SIGMAS)


def _distances_sigmas(given: Correspondences) -> Float64[np.ndarray, " n"]:
    """Distance of each keypoint in the image from the mean of all, in its standard deviations."""
    off = given.positions_px - given.positions_px.mean(axis=0)
    whitened = (given.whitening @ off[..., None])[..., 0]
    distances: Float64[np.ndarray, " n"] = np.sqrt(np.vecdot(whitened, whitened))
    return distances
