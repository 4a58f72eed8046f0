"""An object's pose from its keypoints in one image, and from depth where there is some."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.geometry import spread_m
from rpl_data.pose.correspondences import Correspondences
from rpl_data.pose.refine import covariance_of, refined, reprojection_sigmas
from rpl_data.pose.solvers import FEWEST, SOLVERS

Method = Literal["epnp", "sqpnp", "ransac", "consensus"]

Reason = Literal[
    "too few keypoints", "keypoints on a line", "keypoints in a plane", "keypoints disagree", "not in front"
]

THINNEST = 0.01
"""A set this thin, as a share of its extent, is a line or a plane: a plane seen with a few pixels of noise
allows two poses (Schweighofer and Pinz, PAMI 28, 2006), and EPnP is unstable on it."""


@dataclass(frozen=True)
class PoseEstimate:
    """A pose and how far to trust it.

    Attributes:
        camera_from_object: metres.
        keypoints: numbers of the keypoints it rests on.
        covariance: 6x6 of a small rotation about the object's origin (rad, camera axes) and a translation
            (metres), in this order; from the covariance of the keypoints.
        error_sigmas: how far those keypoints are from where the pose puts them, root mean square of an
            axis, in their standard deviations: about 1 when these are right.
    """

    camera_from_object: Float64[np.ndarray, "4 4"]
    keypoints: Int64[np.ndarray, " n"]
    covariance: Float64[np.ndarray, "6 6"]
    error_sigmas: float


@dataclass(frozen=True)
class PoseFailure:
    """Why there is no pose."""

    reason: Reason


def estimate_pose(
    given: Correspondences, *, method: Method = "consensus", refine: bool = True
) -> PoseEstimate | PoseFailure:
    """``camera_from_object`` from keypoints, or why not.

    Args:
        given: of `correspondences`.
        method: `epnp` is the paper's, `sqpnp` its better; both believe every keypoint. `ransac` and
            `consensus` leave wrong ones out.
        refine: Levenberg-Marquardt behind it, weighted by the covariances and with the depths (robust
            where there are any, since depth may belong to what hides the keypoint); the paper has none.
    """
    if (refusal := _refusal(given)) is not None:
        return refusal
    attempt = SOLVERS[method](given)
    if attempt is None:
        return PoseFailure("keypoints disagree")
    pose, inliers = attempt
    rest = given.only(inliers)
    if (refusal := _refusal(rest)) is not None:
        return PoseFailure("keypoints disagree") if refusal.reason == "too few keypoints" else refusal
    if refine:
        pose = refined(pose[None], rest, robust=bool(np.isfinite(rest.depth_m).any()))[0]
    sigmas = reprojection_sigmas(pose[None], rest)[0]
    if not np.isfinite(sigmas).all():
        return PoseFailure("not in front")
    return PoseEstimate(
        pose, rest.keypoints, covariance_of(pose, rest), float(np.sqrt(np.mean(sigmas**2) / 2))
    )


def _refusal(given: Correspondences) -> PoseFailure | None:
    """Why these points cannot tell a pose, whatever the image."""
    if len(given) < FEWEST:
        return PoseFailure("too few keypoints")
    length, width, height = spread_m(given.points_object)
    if width <= THINNEST * length:
        return PoseFailure("keypoints on a line")
    return PoseFailure("keypoints in a plane") if height <= THINNEST * length else None
