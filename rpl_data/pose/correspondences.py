"""Keypoints of a model and where they were seen in an image: the input of every pose solver."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float64, Int64

from rpl_data.geometry import rays
from rpl_data.types import Intrinsics

USUAL_SIGMA_PX = 2.0
"""Assumed standard deviation of a keypoint per axis, when no covariance is given."""


@dataclass(frozen=True)
class Correspondences:
    """Model points with their positions in the image; n rows.

    Attributes:
        keypoints: number of each row's keypoint in the model.
        points_object: model points, metres, object frame.
        positions_px: pixels from the principal point, lens distortion removed.
        focal_px: fx, fy.
        whitening: matrix that turns a residual in pixels into one of unit variance per axis.
        depth_m: depth of the keypoint along the optical axis; NaN where unknown.
        depth_sigma_m: its standard deviation; NaN where unknown.
    """

    keypoints: Int64[np.ndarray, " n"]
    points_object: Float64[np.ndarray, "n 3"]
    positions_px: Float64[np.ndarray, "n 2"]
    focal_px: Float64[np.ndarray, "2"]
    whitening: Float64[np.ndarray, "n 2 2"]
    depth_m: Float64[np.ndarray, " n"]
    depth_sigma_m: Float64[np.ndarray, " n"]

    def __len__(self) -> int:
        """How many rows."""
        return len(self.keypoints)

    @property
    def camera_matrix(self) -> Float64[np.ndarray, "3 3"]:
        """Camera matrix for `positions_px`: the principal point is 0, 0."""
        return np.diag([self.focal_px[0], self.focal_px[1], 1.0])

    def only(self, rows: Bool[np.ndarray, " n"]) -> Correspondences:
        """Those rows."""
        kept = {
            field.name: getattr(self, field.name)[rows] for field in fields(self) if field.name != "focal_px"
        }
        return Correspondences(focal_px=self.focal_px, **kept)


def correspondences(
    points_object: Float64[np.ndarray, "k 3"],
    keypoints_px: Float64[np.ndarray, "k 2"],
    intrinsics: Intrinsics,
    *,
    covariance_px: Float64[np.ndarray, "k 2 2"] | None = None,
    depth_m: Float64[np.ndarray, " k"] | None = None,
    depth_sigma_m: Float64[np.ndarray, " k"] | None = None,
) -> Correspondences:
    """Collect the keypoints that have both a model point and a position; NaN in either excludes one.

    So does a covariance that is none, such as that of a heatmap that collapsed onto one pixel.

    Args:
        points_object: one row per keypoint, metres, object frame.
        keypoints_px: where each was seen in the image, with the lens's distortion.
        intrinsics: camera of that image.
        covariance_px: covariance of each position; `USUAL_SIGMA_PX` on both axes when left out.
        depth_m: depth along the optical axis, NaN where there is none.
        depth_sigma_m: standard deviation of `depth_m`; must be given with it.
    """
    known = np.isfinite(points_object).all(axis=1) & np.isfinite(keypoints_px).all(axis=1)
    if covariance_px is None:
        whitening = np.tile(np.eye(2) / USUAL_SIGMA_PX, (int(known.sum()), 1, 1))
    else:
        known[known] = _are_covariances(covariance_px[known])
        whitening = np.linalg.inv(np.linalg.cholesky(covariance_px[known]))
    nothing = np.full(len(points_object), np.nan)
    focal_px = np.array([intrinsics.fx, intrinsics.fy])
    return Correspondences(
        keypoints=np.flatnonzero(known).astype(np.int64),
        points_object=points_object[known],
        positions_px=rays(intrinsics, keypoints_px[known])[:, :2] * focal_px,
        focal_px=focal_px,
        whitening=whitening,
        depth_m=(nothing if depth_m is None else depth_m)[known],
        depth_sigma_m=(nothing if depth_sigma_m is None else depth_sigma_m)[known],
    )


def _are_covariances(matrices: Float64[np.ndarray, "n 2 2"]) -> Bool[np.ndarray, " n"]:
    """Which of them are finite, with a positive variance along every direction."""
    finite = np.isfinite(matrices).all(axis=(1, 2))
    variances = np.linalg.eigvalsh(np.where(finite[:, None, None], matrices, np.eye(2)))
    sound: Bool[np.ndarray, " n"] = finite & (variances[:, 0] > 1e-12 * variances[:, 1])
    return sound
