"""Eq. 2 of the paper on lifted points, by generalised Procrustes analysis.

    min over Q, T of  sum_(s, k clicked) | T_s Q_k - W_sk |^2

Gower's alternation (Psychometrika 40, 1975) without scaling: with the T_s fixed every Q_k is a mean,
with the Q_k fixed every T_s is Kabsch's closed form; both steps lower the cost.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float64

Loss = Literal["robust", "l2"]

ROBUST_SCALES_M = (0.05, 0.02, 0.012, 0.012)
"""Scales of Geman-McClure's loss, wide to narrow; 12 mm is where a click is called wrong."""
MOST_ALTERNATIONS = 2000
"""Gower's alternation ends there if it has not converged."""


class Fragments(NamedTuple):
    """The paper's W: a point per scene and keypoint, scene frame, and 1 where it was clicked.

    Where it was not, `clicked` is 0, and the point is any finite one.
    """

    points_scene: Float64[np.ndarray, "s k 3"]
    clicked: Float64[np.ndarray, "s k"]


class Adjusted(NamedTuple):
    """Scene transforms and model points, and the weight each fragment had in the end."""

    scene_from_model: Float64[np.ndarray, "s 4 4"]
    points_model: Float64[np.ndarray, "k 3"]
    weights: Float64[np.ndarray, "s k"]


def eq2_cost(fragments: Fragments, adjusted: Adjusted) -> float:
    """The objective of Eq. 2, square metres."""
    return float((_squared_errors(fragments, adjusted.scene_from_model, adjusted.points_model)).sum())


def adjust_points(
    fragments: Fragments, scene_from_model: Float64[np.ndarray, "s 4 4"], *, loss: Loss = "robust"
) -> Adjusted:
    """Minimise Eq. 2 (`l2`), or its robust version, from a start.

    `robust` re-weights the fragments by Geman-McClure's loss, with a scale that shrinks.
    """
    weights = fragments.clicked
    adjusted = _alternate(fragments, weights, scene_from_model)
    if loss == "l2":
        return adjusted
    for scale_m in ROBUST_SCALES_M:
        squared = _squared_errors(fragments, adjusted.scene_from_model, adjusted.points_model)
        weights = fragments.clicked / (1 + squared / scale_m**2) ** 2
        adjusted = _alternate(fragments, weights, adjusted.scene_from_model)
    return adjusted


def best_of_starts(
    fragments: Fragments, starts: Float64[np.ndarray, "n s 4 4"]
) -> Float64[np.ndarray, "s 4 4"]:
    """Transforms of the lowest cost of Eq. 2 that Gower's alternation reaches from any of the starts."""
    transforms, previous = starts.copy(), np.full(len(starts), np.inf)
    points = _means_of_each(fragments, transforms)
    moving = np.arange(len(starts))  # starts whose alternation has not converged
    for _ in range(MOST_ALTERNATIONS):
        transforms[moving] = _kabsch_of_each(fragments, points[moving])
        points[moving] = _means_of_each(fragments, transforms[moving])
        cost = _costs_of_each(fragments, transforms[moving], points[moving])
        falls = previous[moving] - cost > 1e-9 * cost + 1e-18
        previous[moving] = cost
        moving = moving[falls]
        if not len(moving):
            break
    best: Float64[np.ndarray, "s 4 4"] = transforms[previous.argmin()]
    return best


def _kabsch_of_each(fragments: Fragments, points: Float64[np.ndarray, "n k 3"]) -> np.ndarray:
    """Transforms of all scenes for each set of model points, (n, s, 4, 4)."""
    n, scenes = len(points), len(fragments.clicked)
    return kabsch_stack(
        np.repeat(points, scenes, axis=0),
        np.tile(fragments.points_scene, (n, 1, 1)),
        np.tile(fragments.clicked, (n, 1)),
    ).reshape(n, scenes, 4, 4)


def _means_of_each(fragments: Fragments, transforms: Float64[np.ndarray, "n s 4 4"]) -> np.ndarray:
    """Keypoints for each set of transforms, (n, k, 3)."""
    turns, shifts = transforms[..., :3, :3], transforms[..., None, :3, 3]
    in_model = (fragments.points_scene - shifts) @ turns
    total = np.maximum(fragments.clicked.sum(axis=0), 1e-300)
    means: np.ndarray = (fragments.clicked[..., None] * in_model).sum(axis=1) / total[:, None]
    return means


def _costs_of_each(fragments: Fragments, transforms: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Eq. 2 for each set of transforms and points, (n,)."""
    predicted = points[:, None] @ transforms[..., :3, :3].swapaxes(2, 3) + transforms[..., None, :3, 3]
    squared = ((predicted - fragments.points_scene) ** 2).sum(axis=3)
    costs: np.ndarray = (fragments.clicked * squared).sum(axis=(1, 2))
    return costs


def _alternate(
    fragments: Fragments, weights: Float64[np.ndarray, "s k"], scene_from_model: Float64[np.ndarray, "s 4 4"]
) -> Adjusted:
    """Gower's alternation to convergence, in compiled code where every scene's points determine its pose."""
    from rpl_data.solve.compiled_eq2 import alternate

    poses: Float64[np.ndarray, "s 4 4"] = scene_from_model.copy()
    points: Float64[np.ndarray, "k 3"] = np.zeros((weights.shape[1], 3))
    if alternate(*fragments, weights, poses, points, MOST_ALTERNATIONS):
        return Adjusted(poses, points, weights)
    return alternate_by_svd(fragments, weights, scene_from_model)


def alternate_by_svd(
    fragments: Fragments, weights: Float64[np.ndarray, "s k"], scene_from_model: Float64[np.ndarray, "s 4 4"]
) -> Adjusted:
    """Gower's alternation by SVD, which takes any turn about the line where a scene's points lie on one."""
    previous = np.inf
    points = mean_points(fragments.points_scene, weights, scene_from_model)
    for _ in range(MOST_ALTERNATIONS):
        scene_from_model = kabsch_stack(points, fragments.points_scene, weights)
        points = mean_points(fragments.points_scene, weights, scene_from_model)
        cost = (weights * _squared_errors(fragments, scene_from_model, points)).sum()
        if previous - cost <= 1e-9 * cost + 1e-18:
            break
        previous = cost
    return Adjusted(scene_from_model, points, weights)


def _squared_errors(
    fragments: Fragments, scene_from_model: Float64[np.ndarray, "s 4 4"], points: Float64[np.ndarray, "k 3"]
) -> Float64[np.ndarray, "s k"]:
    predicted = points @ np.swapaxes(scene_from_model[:, :3, :3], 1, 2) + scene_from_model[:, None, :3, 3]
    difference = np.where(fragments.clicked[..., None] > 0, predicted - fragments.points_scene, 0.0)
    squared: Float64[np.ndarray, "s k"] = (difference**2).sum(axis=-1)
    return squared


def mean_points(
    points_scene: Float64[np.ndarray, "s k 3"],
    weights: Float64[np.ndarray, "s k"],
    scene_from_model: Float64[np.ndarray, "s 4 4"],
) -> Float64[np.ndarray, "k 3"]:
    """Every keypoint as the weighted mean of its fragments; (0, 0, 0) where it has none."""
    in_model = (points_scene - scene_from_model[:, None, :3, 3]) @ scene_from_model[:, :3, :3]
    total = np.maximum(weights.sum(axis=0), 1e-300)
    means: Float64[np.ndarray, "k 3"] = (weights[..., None] * in_model).sum(axis=0) / total[:, None]
    return means


def kabsch_stack(
    points_model: Float64[np.ndarray, "*b k 3"],
    points_scene: Float64[np.ndarray, "b2 k 3"],
    weights: Float64[np.ndarray, "b2 k"],
) -> Float64[np.ndarray, "b2 4 4"]:
    """Kabsch's `scene_from_model` for a stack of weighted point sets, rotations proper."""
    w = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
    points_model = np.broadcast_to(points_model, points_scene.shape)
    centre_model = w[:, None] @ points_model
    centre_scene = w[:, None] @ points_scene
    weighted = w[..., None] * (points_scene - centre_scene)
    covariance = weighted.swapaxes(1, 2) @ (points_model - centre_model)
    u, _, vt = np.linalg.svd(covariance)
    sign = np.ones((len(w), 3))
    sign[:, 2] = np.sign(np.linalg.det(u @ vt))
    turn = (u * sign[:, None]) @ vt
    transforms = np.tile(np.eye(4), (len(w), 1, 1))
    transforms[:, :3, :3] = turn
    transforms[:, :3, 3] = (centre_scene.swapaxes(1, 2) - turn @ centre_model.swapaxes(1, 2))[..., 0]
    return transforms
