"""The three pose errors of the BOP benchmark: VSD, MSSD and MSPD.

Definitions: Hodan et al., "BOP Challenge 2020 on 6D Object Localization", section 2.2, and `pose_error.py` of
https://github.com/thodan/bop_toolkit, with which these functions agree. Poses are ``camera_from_object``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Float64

from rpl_data.geometry import Pixels, Points, Transform, project, transform
from rpl_data.raycast import PixelTable, RayScene, depth_along_m
from rpl_data.types import Intrinsics

VSD_DELTA_M = 0.015
"""A surface that lies at most this far behind the measured one is seen; the benchmark's value."""
VSD_TAUS = np.arange(0.05, 0.51, 0.05)
"""Distances, in diameters, from which on two surfaces do not match; the benchmark's ten values."""

Symmetries = Float64[np.ndarray, "s 4 4"]
"""Rigid transforms of the object frame that leave the object looking the same, the identity among them."""
Depths = Float[np.ndarray, "h w"]


def mssd_m(estimated: Transform, true: Transform, points_object: Points, symmetries: Symmetries) -> float:
    """Maximum symmetry-aware surface distance, metres.

    The distance of the farthest point from where it should be, for the symmetry that makes it smallest. The
    corners of the convex hull are enough as points: the distance is a convex function of the point.
    """
    here = transform(estimated, points_object)
    apart = (np.linalg.norm(here - transform(true @ same, points_object), axis=1) for same in symmetries)
    return float(min(distances.max() for distances in apart))


def mspd_px(
    estimated: Transform,
    true: Transform,
    points_object: Points,
    intrinsics: Intrinsics,
    symmetries: Symmetries,
) -> float:
    """Maximum symmetry-aware projection distance, pixels; infinite where a point is behind the camera."""

    def seen(camera_from_object: Transform) -> Pixels:
        return project(intrinsics, transform(camera_from_object, points_object))

    here = seen(estimated)
    apart = (np.linalg.norm(here - seen(true @ same), axis=1).max() for same in symmetries)
    return float(min((np.inf if np.isnan(distance) else distance for distance in apart), default=np.inf))


def vsd(
    estimated_m: Depths,
    true_m: Depths,
    measured_m: Depths,
    *,
    diameter_m: float,
    taus: Sequence[float] | Float64[np.ndarray, " t"] = VSD_TAUS,
    delta_m: float = VSD_DELTA_M,
) -> Float64[np.ndarray, " t"]:
    """Visible surface discrepancy, 0 to 1, one per tau.

    The share of the pixels, of those that see the object in either pose, where the two surfaces do not match:
    only one of them is seen, or they are at least tau diameters apart.

    Args:
        estimated_m, true_m: distances from the camera's centre to the model in both poses; 0 = not there.
        measured_m: distances that the sensor measured; 0 = none, where the model counts as seen.
        diameter_m: of the object.
        taus: tolerances, in diameters.
        delta_m: how far behind the measured surface the model still counts as seen.
    """

    def in_sight(model_m: Depths) -> Bool[np.ndarray, "h w"]:
        return np.asarray((model_m > 0) & ((model_m - measured_m <= delta_m) | (measured_m == 0)))

    true_seen = in_sight(true_m)
    estimated_seen = in_sight(estimated_m) | (true_seen & (estimated_m > 0))
    both, either = true_seen & estimated_seen, int((true_seen | estimated_seen).sum())
    if not either:
        return np.ones(len(taus))
    apart = np.abs(true_m[both] - estimated_m[both]) / diameter_m
    wrong = np.array([(apart >= tau).sum() for tau in taus])
    return np.asarray((wrong + either - both.sum()) / either, dtype=np.float64)


def rendered_vsd(
    estimated: Transform,
    true: Transform,
    measured_m: Depths,
    *,
    rays: RayScene,
    table: PixelTable,
    corners: Points,
    diameter_m: float,
) -> Float64[np.ndarray, " t"]:
    """Render both poses and return `vsd` with the benchmark's tolerances.

    Args:
        estimated, true: the poses.
        measured_m: the sensor's depth image at the colour pixels, metres along the optical axis; 0 = none.
        rays: the object's mesh.
        table: directions of the camera's pixels.
        corners: points, object frame, whose hull holds the mesh: only around them is rendered.
        diameter_m: of the object.
    """
    both = np.concatenate([transform(pose, corners) for pose in (estimated, true)])
    window = table.window(both)
    if window is None:
        return np.ones(len(VSD_TAUS))
    directions = table.directions[window]
    stretch = np.linalg.norm(directions.astype(np.float64), axis=2)
    here, there = (depth_along_m(rays, directions, pose) * stretch for pose in (estimated, true))
    return vsd(here, there, measured_m[window] * stretch, diameter_m=diameter_m)
