"""One labelling for all poses of one look: what a network is taught of a symmetric object.

A symmetric object has several poses that look the same, each with its own keypoints; a network taught all of
them learns their mean. So one is chosen by a rule (Pitteri et al., "On Object Symmetries and 6D Pose
Estimation from Images", 3DV 2019).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import Points, Transform, project, square_box, transform
from rpl_data.json_arrays import asdict_values
from rpl_data.motions import cross_matrices
from rpl_data.symmetries import symmetry_transforms, turn
from rpl_data.types import Intrinsics, Symmetries, SymmetryAxis

SAME_PLACE_M = 0.003
"""Keypoints of a symmetric object are clicked this well where others would lie after a turn."""


Label = tuple[Transform, Float64[np.ndarray, "k 3"], Float64[np.ndarray, "3"]]
"""camera_from_object; u, v and visibility of the keypoints; centre and side of the square box, px."""


def canonical_label(
    camera_from_object: Transform,
    keypoints: Float64[np.ndarray, "k 3"],
    box: Float64[np.ndarray, "3"],
    symmetries: Symmetries,
    points_object: Points,
    camera: Intrinsics,
) -> Label:
    """Label an instance with the canonical one of the poses that look the same."""
    symmetry = canonical_symmetry(symmetries, camera_from_object)
    if np.allclose(symmetry, np.eye(4), atol=1e-12):
        return camera_from_object, keypoints, box
    placed = canonical_keypoints(keypoints, camera_from_object, symmetry, points_object, camera)
    around = placed[placed[:, 2] > 0, :2]
    if len(around) > 1:  # else it is the box of the mask
        box = np.array(asdict_values(square_box(around)))
    return camera_from_object @ symmetry, placed, box


def canonical_symmetry(symmetries: Symmetries, camera_from_object: Transform) -> Transform:
    """Choose, of the poses that look the same, the one whose axes are nearest to those of the camera.

    Nearest means the smallest angle of rotation, so the largest trace. About an axis of full rotation the
    best angle has a closed form; of several such axes only the first counts.

    Returns:
        `symmetry`: ``camera_from_object @ symmetry`` is the same for all poses that look the same, up to
        rounding.
    """
    fixed = symmetry_transforms(Symmetries(symmetries.discrete))
    chosen = list(fixed)
    for axis in symmetries.continuous[:1]:
        chosen = [one @ turn(axis, _best_angle(camera_from_object @ one, axis)) for one in fixed]
    traces = [np.trace((camera_from_object @ one)[:3, :3]) for one in chosen]
    return np.asarray(chosen[int(np.argmax(np.round(traces, 9)))])


def _best_angle(pose: Transform, axis: SymmetryAxis) -> float:
    """The angle about an axis that makes the trace of the pose largest.

    By Rodrigues' formula the trace is a cosine of the angle with these two coefficients.
    """
    direction = np.array(axis.direction)
    rotation, cross = pose[:3, :3], cross_matrices(direction)
    across = np.eye(3) - np.outer(direction, direction)
    return float(np.arctan2(np.trace(rotation @ cross), np.trace(rotation @ across)))


def canonical_keypoints(
    keypoints: Float64[np.ndarray, "k 3"],
    camera_from_object: Transform,
    symmetry: Transform,
    points_object: Points,
    camera: Intrinsics,
) -> Float64[np.ndarray, "k 3"]:
    """Where the keypoints are in the image after a symmetry: u, v, visibility.

    A keypoint that comes to lie where another one was is as visible as that one was; elsewhere that is not
    known, and it counts as hidden (1). What was not labelled stays so.
    """
    labelled = (keypoints[:, 2] > 0) & np.isfinite(points_object).all(axis=1)
    moved = transform(symmetry, points_object)
    placed = np.zeros_like(keypoints)
    placed[labelled, :2] = project(camera, transform(camera_from_object, moved[labelled]))
    apart = np.linalg.norm(moved[labelled, None] - points_object[None, labelled], axis=2)
    seen = keypoints[labelled, 2][apart.argmin(axis=1)] if labelled.any() else np.empty(0)
    placed[labelled, 2] = np.where(apart.min(axis=1, initial=np.inf) < SAME_PLACE_M, seen, 1)
    placed[~np.isfinite(placed).all(axis=1)] = 0
    return placed
