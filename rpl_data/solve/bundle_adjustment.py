"""Rays and depths instead of lifted points: what Eq. 2 becomes when a depth must be earned.

    min over Q, T of  sum_clicks  rho(|pi(C^-1 T_s Q_k) - click|^2 / sigma_px^2)
                                + rho((z - d)^2 / sigma_d^2)

where z is the depth of the keypoint in the clicked camera, d the candidate depth nearest to it, and
rho Geman-McClure's loss, so that a click or a depth that contradicts the rest lets go. Solved by
Levenberg-Marquardt on re-weighted least squares (Triggs et al., Bundle adjustment, 2000).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial.transform import Rotation

from rpl_data.geometry import invert
from rpl_data.types import Observation

CLICK_SIGMA_PX = 2.5
"""Hand, eye and a little of the trajectory; raised to what the clicks themselves show."""
LET_GO = 3.0
"""Geman-McClure's scale in standard deviations."""
BEHIND = 3.0
"""Cost (in the unit of a squared standard deviation) of a candidate that is not the nearest surface:
a person clicks what can be seen, so background is taken only when the other clicks insist."""


class Rays(NamedTuple):
    """Observations as arrays; M clicks. The candidate depths are padded with NaN."""

    scene: Int64[np.ndarray, " m"]
    keypoint: Int64[np.ndarray, " m"]
    camera_from_scene: Float64[np.ndarray, "m 4 4"]
    xy: Float64[np.ndarray, "m 2"]
    pixel_rad: Float64[np.ndarray, " m"]
    depths_m: Float64[np.ndarray, "m c"]
    depth_sigmas_m: Float64[np.ndarray, "m c"]


class Bundle(NamedTuple):
    """The adjusted unknowns and what became of every click.

    Attributes:
        normal: the normal matrix of the last step; the inverse is the covariance of the unknowns
            (6 a scene: rotation, translation; then 3 a keypoint), up to the frame they are in.
        depth_m: the candidate taken; NaN where there was none.
        depth_error_m: z - d; NaN likewise. depth_sigma_m: of d.
    """

    scene_from_model: Float64[np.ndarray, "s 4 4"]
    points_model: Float64[np.ndarray, "k 3"]
    normal: Float64[np.ndarray, "u u"]
    error_px: Float64[np.ndarray, " m"]
    depth_m: Float64[np.ndarray, " m"]
    depth_error_m: Float64[np.ndarray, " m"]
    depth_sigma_m: Float64[np.ndarray, " m"]
    sigma_px: float


def rays_of(observations: Sequence[Observation], scenes: Sequence[str]) -> Rays:
    """Observations as arrays."""
    number = {name: s for s, name in enumerate(scenes)}
    most = max((len(o.depths_m) for o in observations), default=0)
    depths, sigmas = np.full((2, len(observations), max(most, 1)), np.nan)
    for m, o in enumerate(observations):
        depths[m, : len(o.depths_m)] = o.depths_m
        sigmas[m, : len(o.depths_m)] = o.depth_sigmas_m
    return Rays(
        scene=np.array([number[o.click.scene] for o in observations], dtype=np.int64),
        keypoint=np.array([o.click.keypoint for o in observations], dtype=np.int64),
        camera_from_scene=invert(np.stack([o.scene_from_camera for o in observations])),
        xy=np.stack([o.ray_camera[:2] for o in observations]),
        pixel_rad=np.array([o.pixel_rad for o in observations]),
        depths_m=depths,
        depth_sigmas_m=sigmas,
    )


def adjust_rays(
    rays: Rays,
    scene_from_model: Float64[np.ndarray, "s 4 4"],
    points_model: Float64[np.ndarray, "k 3"],
    *,
    hold_points: bool = False,
) -> Bundle:
    """Adjust from a start that is right to a few centimetres.

    Args:
        hold_points: move the scenes only; the model is known.
    """
    free = len(scene_from_model) * 6 + (0 if hold_points else points_model.size)
    state = (scene_from_model, points_model)
    sigma_px = 2 * CLICK_SIGMA_PX
    for let_go in (4 * LET_GO, 2 * LET_GO):  # wide at first, so that a fair start is not let go of
        state = _descend(rays, *state, sigma_px=sigma_px, let_go=let_go, free=free)
    sigma_px = _shown_sigma_px(rays, *state)
    state = _descend(rays, *state, sigma_px=sigma_px, let_go=LET_GO, free=free)
    return _describe(rays, *state, sigma_px=sigma_px)


def _shown_sigma_px(rays: Rays, scene_from_model: np.ndarray, points_model: np.ndarray) -> float:
    """The click noise the residuals show (median of a Rayleigh distribution), never below a hand's."""
    _, lateral_px, _, _ = _residuals(rays, scene_from_model, points_model)
    shown = float(np.median(np.linalg.norm(lateral_px, axis=1)) / 1.1774)
    return min(max(shown, CLICK_SIGMA_PX), 4 * CLICK_SIGMA_PX)


def _residuals(
    rays: Rays, scene_from_model: np.ndarray, points_model: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Keypoints in their cameras (M, 3), pixel errors (M, 2), the depth taken and its sigma (M,)."""
    transforms = rays.camera_from_scene @ scene_from_model[rays.scene]
    points = points_model[rays.keypoint]
    in_camera = np.einsum("mij,mj->mi", transforms[:, :3, :3], points) + transforms[:, :3, 3]
    z = np.maximum(in_camera[:, 2:], 0.05)
    lateral_px = (in_camera[:, :2] / z - rays.xy) / rays.pixel_rad[:, None]
    clicks = np.arange(len(rays.depths_m))
    choice = _candidate_costs(rays.depths_m, rays.depth_sigmas_m, in_camera[:, 2]).argmin(axis=1)
    return in_camera, lateral_px, rays.depths_m[clicks, choice], rays.depth_sigmas_m[clicks, choice]


def _candidate_costs(depths_m: np.ndarray, sigmas_m: np.ndarray, z_m: np.ndarray) -> np.ndarray:
    """What each candidate depth (M, c) would cost at depths z (..., M); infinite where there is none."""
    squared = ((depths_m - z_m[..., None]) / sigmas_m) ** 2
    let_go = squared / (1 + squared / LET_GO**2)
    behind = BEHIND * (np.arange(depths_m.shape[1]) > 0)
    return np.where(np.isfinite(depths_m), let_go + behind, np.inf)


def choose_places(
    rays: Rays,
    scene_from_model: Float64[np.ndarray, "s 4 4"],
    points_model: Float64[np.ndarray, "k 3"],
    places_model: Sequence[Float64[np.ndarray, "_ 3"]],
) -> Float64[np.ndarray, "k 3"]:
    """Every keypoint at the cheapest of its present place and the given ones, scenes held fixed.

    The adjustment only slides along a ray to the next candidate depth; this jumps over the hill.
    """
    camera_from_model = rays.camera_from_scene @ scene_from_model[rays.scene]
    chosen = points_model.copy()
    for k, places in enumerate(places_model):
        own = rays.keypoint == k
        if own.any() and len(places):
            candidates = np.vstack([points_model[k][None], places])
            some = Rays(*(column[own] for column in rays))
            chosen[k] = candidates[_clicks_costs(some, camera_from_model[own], candidates).argmin()]
    return chosen


def _clicks_costs(rays: Rays, camera_from_model: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Robust cost of one keypoint's clicks if it were at each of the places."""
    in_camera = np.einsum("mij,pj->pmi", camera_from_model[:, :3, :3], places) + camera_from_model[:, :3, 3]
    z = np.maximum(in_camera[..., 2:], 0.05)
    lateral_px = (in_camera[..., :2] / z - rays.xy) / rays.pixel_rad[:, None]
    squared = ((lateral_px / (2 * CLICK_SIGMA_PX)) ** 2).sum(axis=2)
    nearest = _candidate_costs(rays.depths_m, rays.depth_sigmas_m, in_camera[..., 2]).min(axis=2)
    depth = np.minimum(nearest, LET_GO**2 + BEHIND)
    costs: np.ndarray = (squared / (1 + squared / (2 * LET_GO) ** 2) + depth).sum(axis=1)
    return costs


def _weighted_system(
    rays: Rays, scene_from_model: np.ndarray, points_model: np.ndarray, *, sigma_px: float, let_go: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Re-weighted Jacobian (3M, unknowns) and residuals (3M), and the robust cost."""
    in_camera, lateral_px, depth, sigma_d = _residuals(rays, scene_from_model, points_model)
    measured = np.isfinite(depth)
    normed = np.column_stack(
        [lateral_px / sigma_px, np.where(measured, (in_camera[:, 2] - depth) / sigma_d, 0)]
    )
    squared = np.column_stack([(normed[:, :2] ** 2).sum(axis=1), normed[:, 2] ** 2])
    root_weight = 1 / (1 + squared / let_go**2)
    cost = float((squared / (1 + squared / let_go**2)).sum())
    weight = root_weight[:, [0, 0, 1]]

    rows = _normed_gradient(in_camera, rays.pixel_rad * sigma_px, np.where(measured, sigma_d, np.inf))
    rotation = rays.camera_from_scene[:, :3, :3]
    poses = scene_from_model[rays.scene]
    in_scene = np.einsum("mij,mj->mi", poses[:, :3, :3], points_model[rays.keypoint]) + poses[:, :3, 3]
    by_pose = rows @ rotation
    by_turn = -by_pose @ _cross(in_scene)
    by_point = by_pose @ poses[:, :3, :3]

    scenes = len(scene_from_model)
    jacobian = np.zeros((len(rays.scene), 3, 6 * scenes + 3 * len(points_model)))
    m = np.arange(len(rays.scene))
    for axis in range(3):
        jacobian[m, :, 6 * rays.scene + axis] = by_turn[:, :, axis]
        jacobian[m, :, 6 * rays.scene + 3 + axis] = by_pose[:, :, axis]
        jacobian[m, :, 6 * scenes + 3 * rays.keypoint + axis] = by_point[:, :, axis]
    unknowns = jacobian.shape[2]
    return (weight[..., None] * jacobian).reshape(-1, unknowns), (weight * normed).ravel(), cost


def _normed_gradient(in_camera: np.ndarray, lateral_unit: np.ndarray, depth_unit: np.ndarray) -> np.ndarray:
    """Derivative of the three normed residuals by the point in the camera, (M, 3, 3)."""
    z = np.maximum(in_camera[:, 2], 0.05)
    rows = np.zeros((len(z), 3, 3))
    rows[:, 0, 0] = rows[:, 1, 1] = 1 / (z * lateral_unit)
    rows[:, 0, 2] = -in_camera[:, 0] / (z**2 * lateral_unit)
    rows[:, 1, 2] = -in_camera[:, 1] / (z**2 * lateral_unit)
    rows[:, 2, 2] = 1 / depth_unit
    return rows


def _cross(vectors: Float64[np.ndarray, "m 3"]) -> Float64[np.ndarray, "m 3 3"]:
    """Matrices [v] with [v] w = v x w."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _descend(
    rays: Rays,
    scene_from_model: np.ndarray,
    points_model: np.ndarray,
    *,
    sigma_px: float,
    let_go: float,
    free: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt to convergence on the first `free` unknowns."""
    damping = 1e-4
    jacobian, residual, cost = _weighted_system(
        rays, scene_from_model, points_model, sigma_px=sigma_px, let_go=let_go
    )
    for _ in range(60):
        normal = jacobian[:, :free].T @ jacobian[:, :free]
        damped = (
            normal
            + damping * np.diag(np.diag(normal))
            + 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal))
        )
        step = np.zeros(jacobian.shape[1])
        step[:free] = np.linalg.solve(damped, -jacobian[:, :free].T @ residual)
        moved = _moved(scene_from_model, points_model, step)
        system = _weighted_system(rays, *moved, sigma_px=sigma_px, let_go=let_go)
        if system[2] < cost:
            finished = cost - system[2] < 1e-7 * cost
            (scene_from_model, points_model), (jacobian, residual, cost) = moved, system
            damping = max(damping / 5, 1e-9)
            if finished:
                break
        else:
            damping *= 10
            if damping > 1e6:
                break
    return scene_from_model, points_model


def _moved(
    scene_from_model: np.ndarray, points_model: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    scenes = len(scene_from_model)
    poses = step[: 6 * scenes].reshape(scenes, 6)
    moves = np.tile(np.eye(4), (scenes, 1, 1))
    moves[:, :3, :3] = Rotation.from_rotvec(poses[:, :3]).as_matrix()
    moves[:, :3, 3] = poses[:, 3:]
    return moves @ scene_from_model, points_model + step[6 * scenes :].reshape(-1, 3)


def _describe(
    rays: Rays, scene_from_model: np.ndarray, points_model: np.ndarray, *, sigma_px: float
) -> Bundle:
    jacobian, _, _ = _weighted_system(rays, scene_from_model, points_model, sigma_px=sigma_px, let_go=LET_GO)
    in_camera, lateral_px, depth, depth_sigma = _residuals(rays, scene_from_model, points_model)
    return Bundle(
        scene_from_model=scene_from_model,
        points_model=points_model,
        normal=jacobian.T @ jacobian,
        error_px=np.linalg.norm(lateral_px, axis=1),
        depth_m=depth,
        depth_error_m=in_camera[:, 2] - depth,
        depth_sigma_m=depth_sigma,
        sigma_px=sigma_px,
    )


def model_covariance(bundle: Bundle, known: Bool[np.ndarray, " k"]) -> Float64[np.ndarray, "k 3 3"]:
    """Covariance of the keypoints in the frame of their own centroid; NaN for unknown ones.

    The frame is free (6 unknowns), so the normal matrix is singular; its pseudo-inverse fixes the
    frame by the keypoints as a whole (inner constraints, Triggs et al. section 9).
    """
    scenes = len(bundle.scene_from_model)
    of_poses, of_points = slice(0, 6 * scenes), slice(6 * scenes, None)
    used = np.repeat(known, 3)
    points_block = bundle.normal[of_points, of_points][np.ix_(used, used)]
    across = bundle.normal[of_poses, of_points][:, used]
    reduced = (
        points_block - across.T @ np.linalg.pinv(bundle.normal[of_poses, of_poses], hermitian=True) @ across
    )
    values, vectors = np.linalg.eigh(reduced)
    inverse = (vectors[:, 6:] / np.maximum(values[6:], 1e-12)) @ vectors[:, 6:].T
    covariance = np.full((len(known), 3, 3), np.nan)
    blocks = inverse.reshape(known.sum(), 3, known.sum(), 3)
    covariance[known] = blocks[np.arange(known.sum()), :, np.arange(known.sum())]
    return covariance
