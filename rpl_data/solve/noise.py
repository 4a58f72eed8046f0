"""How far off clicks and depths are, judged by their own residuals, and what that means for the answer.

The variances of clicks and of depths are two components of one adjustment. Each is estimated from the
residuals of its group and their redundancy, the degrees of freedom that the unknowns leave to them
(Förstner, "Ein Verfahren zur Schätzung von Varianz- und Kovarianzkomponenten", 1979). With few clicks
the redundancy is small, so a prior, what is usual for a hand and a sensor, counts as a few residuals more.

Depths of one keypoint seen from one side err together (`shared_errors`). The adjustment follows such an
error, so it hardly shows in the residuals, and more clicks do not lower it: both are reckoned with here.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int64

from rpl_data.motions import cross_matrices
from rpl_data.solve.bundle_adjustment import State, System, descend, linearise
from rpl_data.solve.click_rays import HAND_SIGMA_PX, Noise, Rays
from rpl_data.solve.shared_errors import both, shared_errors
from rpl_data.solve.sparse_normal import Parts, normal_by_scenes, parts_by_scene

USUAL = Noise(click_px=HAND_SIGMA_PX, depth_ratio=2.0)
"""What is expected before anything is known: a careful hand, and depths as bad as at the corners
of a real cube, twice what is stated. On rendered recordings they are as good as stated; where scenes see an
object from different sides, its clicks show that."""
PRIOR_RESIDUALS = 3.0
"""The prior counts as much as this many residuals."""
SMALLEST, LARGEST = Noise(0.25, 0.4), Noise(10.0, 6.0)
"""Bounds of the estimate; beyond them the model of the noise is wrong, not its size."""
NOISE_STAYS = 0.02
"""Relative change at which the estimate has come to rest."""
HIDDEN_BY_WEIGHTS = (0.745, 0.733)
"""Weighted mean square of normal residuals of variance 1 under Geman-McClure's weights at 3 sigmas: of
pixels (two dimensions), of depths (one)."""
INFORMATION_PER_WEIGHT = (1.236, 1.076)
"""Information of a residual over its weight, likewise: good residuals have weights below 1, yet the estimate
is nearly as good as that by least squares (Huber, Robust Statistics, 1981, section 6.3)."""


def adjust_with_noise(
    rays: Rays, state: State, *, prior: Noise = USUAL, hold_points: bool = False, most_rounds: int = 20
) -> tuple[State, Noise]:
    """Descend, estimate the noise, and descend again with it, until it stays.

    A few rounds are not enough where depths err together: at first they are believed and leave small
    residuals, and only as they lose weight do the rays show how far off they are.

    Args:
        prior: the noise expected before the residuals are seen.
        hold_points: move the scenes only; the model is known.
    """
    noise = Noise()
    for _ in range(most_rounds):
        state = descend(rays, state, noise=noise, hold_points=hold_points)
        before, noise = noise, estimate_noise(rays, state, noise=noise, prior=prior, hold_points=hold_points)
        if np.allclose(noise, before, rtol=NOISE_STAYS):
            break
    return descend(rays, state, noise=noise, hold_points=hold_points), noise


def estimate_noise(
    rays: Rays, state: State, *, noise: Noise, prior: Noise = USUAL, hold_points: bool = False
) -> Noise:
    """The noise that the residuals show.

    Args:
        noise: with which the residuals are weighted: the last estimate.
        prior: the noise expected before the residuals are seen.
        hold_points: the model is known; only the scenes were adjusted.
    """
    system = linearise(rays, state, noise=noise)
    weight = system.root_weight**2
    weighted = system.root_weight[..., None] * system.jacobian
    parts = _parts(rays, state)
    inverse = _inverse(weighted, parts, state, hold_points=hold_points)
    leverage = np.empty_like(weight)
    for own, columns in parts:
        rows = weighted[own][:, :, columns]
        leverage[own] = ((rows @ inverse[np.ix_(columns, columns)]) * rows).sum(axis=-1)
    shared = system.root_weight[:, 2:] * _shared_beyond_stated(rays, state) * system.root_weight[:, 2]
    redundancy = weight * (1 - leverage) + _left_of_shared(weighted, inverse, shared, parts, rays.keypoint)
    measured = np.isfinite(rays.depths_m[:, 0])
    squares = weight * system.residual**2
    click = _variance(
        squares[:, :2].sum() / HIDDEN_BY_WEIGHTS[0],
        redundancy[:, :2].sum(),
        now=noise.click_px,
        usual=prior.click_px,
    )
    # What clicks share widens their deviation, but not how far each of them is off.
    own = rays.widening[measured] ** 2
    depth = _variance(
        float(own @ squares[measured, 2]) / HIDDEN_BY_WEIGHTS[1],
        float(own @ redundancy[measured, 2]),
        now=noise.depth_ratio,
        usual=prior.depth_ratio,
    )
    return Noise(
        float(np.clip(np.sqrt(click), SMALLEST.click_px, LARGEST.click_px)),
        float(np.clip(np.sqrt(depth), SMALLEST.depth_ratio, LARGEST.depth_ratio)),
    )


def _variance(squares: float, redundancy: float, *, now: float, usual: float) -> float:
    """The variance that the squares of residuals, normed by `now`, show together with the prior."""
    return float((PRIOR_RESIDUALS * usual**2 + now**2 * squares) / (PRIOR_RESIDUALS + redundancy))


def _shared_beyond_stated(rays: Rays, state: State) -> Float64[np.ndarray, "m m"]:
    """Covariance of the depth errors less what the adjustment takes it for, in its own units.

    The adjustment takes them for independent, with the widened deviations.
    """
    shared = shared_errors(rays.keypoint, directions_in_model(rays, state))
    beyond: Float64[np.ndarray, "m m"] = shared / np.outer(rays.widening, rays.widening) - np.eye(len(shared))
    return beyond


def widened_for_all_scenes(rays: Rays, state: State) -> Rays:
    """The rays, their depths widened for what the clicks of a keypoint share in all scenes together.

    From which side each scene sees the object is known once the scenes are placed.
    """
    together = both(np.isfinite(rays.depths_m[:, 0]))
    shared = shared_errors(rays.keypoint, directions_in_model(rays, state), together)
    widened = np.sqrt(shared.sum(axis=1))
    sigmas_m = rays.depth_sigmas_m * (widened / rays.widening)[:, None]
    return rays._replace(depth_sigmas_m=sigmas_m, widening=widened)


def directions_in_model(rays: Rays, state: State) -> Float64[np.ndarray, "m 3"]:
    """Unit vectors along the clicked rays, in the model's frame."""
    camera_from_model = (rays.camera_from_scene @ state.scene_from_model[rays.scene])[:, :3, :3]
    in_camera = np.column_stack([rays.xy, np.ones(len(rays.xy))])
    directions = (in_camera[:, None] @ camera_from_model)[:, 0]
    unit: Float64[np.ndarray, "m 3"] = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return unit


def _parts(rays: Rays, state: State) -> Parts:
    return parts_by_scene(rays.scene, len(state.scene_from_model), state.points_model.size)


def _by_depths(
    weighted: Float64[np.ndarray, "m 3 u"], inverse: Float64[np.ndarray, "u u"], parts: Parts
) -> Float64[np.ndarray, "u m"]:
    """By how much each depth moves the unknowns: N^-1 J', in the rows of the depths."""
    moves = np.empty((len(inverse), len(weighted)))
    for own, columns in parts:
        moves[:, own] = inverse[:, columns] @ weighted[own, 2][:, columns].T
    return moves


def _times_shared(
    left: Float64[np.ndarray, "u m"], shared: Float64[np.ndarray, "m m"], keypoint: Int64[np.ndarray, " m"]
) -> Float64[np.ndarray, "u m"]:
    """The product with a covariance of the depths, which is 0 between clicks of different keypoints."""
    product = np.empty_like(left)
    for k in np.unique(keypoint):
        own = np.flatnonzero(keypoint == k)
        product[:, own] = left[:, own] @ shared[np.ix_(own, own)]
    return product


def _left_of_shared(
    weighted: Float64[np.ndarray, "m 3 u"],
    inverse: Float64[np.ndarray, "u u"],
    shared: Float64[np.ndarray, "m m"],
    parts: Parts,
    keypoint: Int64[np.ndarray, " m"],
) -> Float64[np.ndarray, "m 3"]:
    """What a covariance of the depths adds to the expected squares of the residuals after the adjustment.

    The diagonal of M S M for the residual-forming M = 1 - J N^-1 J', with S in the rows of the depths only.
    """
    moves = _by_depths(weighted, inverse, parts)
    pulled = _times_shared(moves, shared, keypoint)
    left = np.empty(weighted.shape[:2])
    for own, columns in parts:
        rows, spread = weighted[own][:, :, columns], pulled[columns] @ moves[columns].T
        left[own] = ((rows @ spread) * rows).sum(axis=-1)
    left[:, 2] += np.diag(shared) - 2 * (weighted[:, 2] * pulled.T).sum(axis=1)
    return left


def _inverse(
    jacobian: Float64[np.ndarray, "m 3 u"], parts: Parts, state: State, *, hold_points: bool
) -> Float64[np.ndarray, "u u"]:
    """Inverse of the normal matrix, as `inverse_normal`."""
    normal = normal_by_scenes(jacobian, parts)
    return inverse_normal(normal, scenes=len(state.scene_from_model), hold_points=hold_points)


def inverse_normal(
    normal: Float64[np.ndarray, "u u"], *, scenes: int, hold_points: bool
) -> Float64[np.ndarray, "u u"]:
    """Inverse of a normal matrix, 0 for what is held.

    The frame of the unknowns is free, so unless the points are held the first scene is. Keypoints
    without clicks are left out.
    """
    free = np.diag(normal) > 0
    free[slice(6 * scenes, None) if hold_points else slice(0, 6)] = False
    inverse: Float64[np.ndarray, "u u"] = np.zeros_like(normal)
    some = normal[np.ix_(free, free)]
    scale = 1 / np.sqrt(np.diag(some))  # metres and radians: comparable before the ridge
    regular = some * np.outer(scale, scale) + 1e-9 * np.eye(len(some))
    inverse[np.ix_(free, free)] = np.linalg.inv(regular) * np.outer(scale, scale)
    return inverse


def joint_covariance(
    rays: Rays, state: State, *, noise: Noise, hold_points: bool = False
) -> Float64[np.ndarray, "u u"]:
    """Covariance of all unknowns, in the order of `System.jacobian`, with the first scene (or points) held.

    Only what does not depend on the frame may be read from it: `points_in_scene_covariance` and
    `shape_covariance`.
    """
    root = _root_information(linearise(rays, state, noise=noise))
    inverse = _inverse(root, _parts(rays, state), state, hold_points=hold_points)
    return with_shared_errors(inverse, rays, state, noise=noise)


def with_shared_errors(
    inverse: Float64[np.ndarray, "u u"], rays: Rays, state: State, *, noise: Noise
) -> Float64[np.ndarray, "u u"]:
    """Covariance of the unknowns from the inverse of their normal matrix, with depths that err together.

    An adjustment that takes errors for independent answers N^-1 J' e; the covariance of that is
    N^-1 J' S J N^-1 for any covariance S of the errors e (White, Econometrica 48, 1980).

    Args:
        inverse: of the normal matrix of the clicks, or of the clicks and more (`inverse_normal`).
    """
    root = _root_information(linearise(rays, state, noise=noise))
    moves = _by_depths(root, inverse, _parts(rays, state))
    pulled = _times_shared(moves, _shared_beyond_stated(rays, state), rays.keypoint)
    covariance: Float64[np.ndarray, "u u"] = inverse + pulled @ moves.T
    return covariance


def _root_information(system: System) -> Float64[np.ndarray, "m 3 u"]:
    """Jacobian times the square roots of the information of each residual."""
    root: Float64[np.ndarray, "m 3 u"] = (
        system.root_weight * np.sqrt(np.array(INFORMATION_PER_WEIGHT)[[0, 0, 1]])
    )[..., None] * system.jacobian
    return root


def points_in_scene_covariance(
    joint: Float64[np.ndarray, "u u"], state: State, scene: int, known: Bool[np.ndarray, " k"]
) -> Float64[np.ndarray, "k 3 3"]:
    """One covariance per keypoint of its position in a scene, in m^2, in the scene frame.

    First order, from shape and pose together with what they share; NaN for unknown keypoints.
    """
    scenes, keypoints = len(state.scene_from_model), len(state.points_model)
    pose = state.scene_from_model[scene]
    in_scene = state.points_model @ pose[:3, :3].T + pose[:3, 3]
    covariance = np.full((keypoints, 3, 3), np.nan)
    for k in np.flatnonzero(known):
        own = np.r_[6 * scene : 6 * scene + 6, 6 * scenes + 3 * k : 6 * scenes + 3 * k + 3]
        derivative = np.hstack([-cross_matrices(in_scene[k]), np.eye(3), pose[:3, :3]])
        covariance[k] = derivative @ joint[np.ix_(own, own)] @ derivative.T
    return covariance


def shape_covariance(
    joint: Float64[np.ndarray, "u u"], state: State, known: Bool[np.ndarray, " k"]
) -> Float64[np.ndarray, "k 3 3"]:
    """One covariance per keypoint in the frame of all keypoints together, in m^2, along the model's axes.

    Motions of all keypoints together are taken out (inner constraints, Triggs et al. section 9). NaN for
    unknown keypoints.
    """
    points = state.points_model[known] - state.points_model[known].mean(axis=0)
    together = np.concatenate(
        [np.tile(np.eye(3), (len(points), 1, 1)), -cross_matrices(points)], axis=2
    ).reshape(-1, 6)
    of_points = 6 * len(state.scene_from_model) + np.flatnonzero(np.repeat(known, 3))
    shape = np.eye(len(together)) - together @ np.linalg.pinv(together)
    projected = shape @ joint[np.ix_(of_points, of_points)] @ shape.T
    covariance = np.full((len(known), 3, 3), np.nan)
    blocks = projected.reshape(len(points), 3, len(points), 3)
    covariance[known] = blocks[np.arange(len(points)), :, np.arange(len(points))]
    return covariance
