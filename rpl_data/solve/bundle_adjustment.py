"""Bundle adjustment of rays and depths: what Eq. 2 becomes when a depth must be earned.

    min over Q, T of  sum_clicks  rho(|pi(C^-1 T_s Q_k) - click|^2 / sigma_px^2)
                                + rho((z - d)^2 / sigma_d^2)

where z is the depth of the keypoint in the clicked camera, d the depth of the cheapest candidate surface
there, and rho Geman-McClure's loss, so that a click or a depth that contradicts the rest loses its weight.
Solved by Levenberg-Marquardt on re-weighted least squares (Triggs et al., Bundle adjustment, 2000).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from rpl_data.motions import cross_matrices, transform_each
from rpl_data.solve.click_rays import (
    FARTHER_SURFACE_PENALTY,
    KERNEL_SCALE_SIGMAS,
    NEAREST_DEPTH_M,
    Misfit,
    Noise,
    Rays,
    click_costs,
    misfit,
    robust,
    squared_errors,
)
from rpl_data.solve.sparse_normal import columns_of, put_together, solved_by_scenes
from rpl_data.solve.straying import shared_by_frames, without_straying

COARSE = Noise(click_px=5.0)
"""While positions may be a few centimetres off."""


class State(NamedTuple):
    """The unknowns: where the object stands in every scene, and where its keypoints are."""

    scene_from_model: Float64[np.ndarray, "s 4 4"]
    points_model: Float64[np.ndarray, "k 3"]


class System(NamedTuple):
    """The linearised problem at a state.

    Attributes:
        jacobian: of the three normed residuals (u, v, depth) of every click by the unknowns: 6 per scene
            (rotation, translation, in the scene frame), then 3 per keypoint.
        residual: the three normed residuals of every click.
        root_weight: square roots of the robust weights.
        cost: the robust cost.
    """

    jacobian: Float64[np.ndarray, "m 3 u"]
    residual: Float64[np.ndarray, "m 3"]
    root_weight: Float64[np.ndarray, "m 3"]
    cost: float


class NormalEquations(NamedTuple):
    """The normal matrix and the gradient by all unknowns, in the order of `System.jacobian`; the cost."""

    normal: Float64[np.ndarray, "u u"]
    gradient: Float64[np.ndarray, " u"]
    cost: float


def adjust(rays: Rays, state: State, *, tolerance: float = 1e-7) -> State:
    """Adjust from a start that is right to a few centimetres.

    The robust loss is wide at first, so that a fair start is not given up.

    Args:
        tolerance: relative decrease of the cost below which the last descent ends.
    """
    for scale in (4 * KERNEL_SCALE_SIGMAS, 2 * KERNEL_SCALE_SIGMAS):
        state = descend(rays, state, noise=COARSE, scale=scale, tolerance=max(tolerance, 1e-3))
    return descend(rays, state, noise=Noise(), tolerance=tolerance)


def descend(
    rays: Rays,
    state: State,
    *,
    noise: Noise,
    scale: float = KERNEL_SCALE_SIGMAS,
    hold_points: bool = False,
    steps: int = 60,
    tolerance: float = 1e-7,
) -> State:
    """Levenberg-Marquardt, until a step lowers the cost by less than `tolerance` of it."""
    free = 6 * len(state.scene_from_model) + (0 if hold_points else state.points_model.size)
    damping = 1e-4
    system = normal_equations(rays, state, noise=noise, scale=scale)
    for _ in range(steps):
        normal = system.normal[:free, :free].copy()
        diagonal = np.diag(normal)
        np.fill_diagonal(normal, diagonal + damping * diagonal + 1e-9 * diagonal.sum() / free)
        step = np.zeros(len(system.normal))
        step[:free] = solved_by_scenes(normal, -system.gradient[:free], len(state.scene_from_model))
        tried = moved(state, step)
        cost = cost_of(rays, tried, noise, scale)
        if cost < system.cost:
            state = tried
            if system.cost - cost < tolerance * system.cost:
                break
            system, damping = normal_equations(rays, state, noise=noise, scale=scale), max(damping / 5, 1e-9)
        else:
            damping *= 10
            if damping > 1e6:
                break
    return state


def moved(state: State, step: Float64[np.ndarray, " u"]) -> State:
    """The state after a step of the unknowns."""
    scenes = len(state.scene_from_model)
    poses = step[: 6 * scenes].reshape(scenes, 6)
    moves = np.tile(np.eye(4), (scenes, 1, 1))
    moves[:, :3, :3] = Rotation.from_rotvec(poses[:, :3]).as_matrix()
    moves[:, :3, 3] = poses[:, 3:]
    return State(moves @ state.scene_from_model, state.points_model + step[6 * scenes :].reshape(-1, 3))


def points_in_cameras(rays: Rays, state: State) -> Float64[np.ndarray, "m 3"]:
    """The clicked keypoints in the cameras of their clicks."""
    camera_from_model = rays.camera_from_scene @ state.scene_from_model[rays.scene]
    return transform_each(camera_from_model, state.points_model[rays.keypoint])


def cost_of(
    rays: Rays, state: State, noise: Noise | None = None, scale: float = KERNEL_SCALE_SIGMAS
) -> float:
    """Robust cost of a state."""
    if rays.strayed_m.any():
        return normal_equations(rays, state, noise=noise or Noise(), scale=scale).cost
    found = misfit(rays, points_in_cameras(rays, state))
    return float(click_costs(found, noise or Noise(), scale).sum())


def linearise(rays: Rays, state: State, *, noise: Noise, scale: float = KERNEL_SCALE_SIGMAS) -> System:
    """Residuals, their derivatives and their robust weights; what straying frames share is eliminated."""
    rows, residual, root_weight, by_scene_point, cost = _linear(rays, state, noise, scale)
    scenes = len(state.scene_from_model)
    jacobian = np.zeros((len(rays.scene), 3, 6 * scenes + state.points_model.size))
    click = np.arange(len(rays.scene))[:, None]
    jacobian[click, :, columns_of(rays.scene, rays.keypoint, scenes)] = rows.swapaxes(1, 2)
    if rays.strayed_m.any():
        weight = root_weight[..., None]
        freed = without_straying(
            root_weight * residual, weight * jacobian, weight * by_scene_point, rays.strayed_m, rays.frame
        )
        residual, jacobian = freed.residual / root_weight, freed.jacobian / weight
        cost -= freed.relief
    return System(jacobian, residual, root_weight, cost)


def normal_equations(
    rays: Rays, state: State, *, noise: Noise, scale: float = KERNEL_SCALE_SIGMAS
) -> NormalEquations:
    """What `linearise` leads to, without ever holding its jacobian, which grows with scenes times clicks."""
    rows, residual, root_weight, by_scene_point, cost = _linear(rays, state, noise, scale)
    rows, residual = root_weight[..., None] * rows, root_weight * residual
    scenes = len(state.scene_from_model)
    columns = columns_of(rays.scene, rays.keypoint, scenes)
    normal, gradient = put_together(rows, residual, columns, 6 * scenes + state.points_model.size)
    by_shift = root_weight[..., None] * by_scene_point
    for shared in shared_by_frames(by_shift, rays.strayed_m, rays.frame):
        own = columns[shared.clicks]
        along = shared.along.reshape(len(own), 3, 3)
        used = np.unique(own)
        by_unknowns = np.zeros((len(used), 3))
        np.add.at(by_unknowns, np.searchsorted(used, own), rows[shared.clicks].swapaxes(1, 2) @ along)
        errors = shared.along.T @ residual[shared.clicks].ravel()
        normal[np.ix_(used, used)] -= by_unknowns * shared.relieved @ by_unknowns.T
        gradient[used] -= by_unknowns @ (shared.relieved * errors)
        cost -= float(shared.relieved @ errors**2)
    return NormalEquations(normal, gradient, cost)


class _Linear(NamedTuple):
    """As `System`, but by the unknowns of each click's own scene and keypoint only."""

    rows: Float64[np.ndarray, "m 3 9"]
    residual: Float64[np.ndarray, "m 3"]
    root_weight: Float64[np.ndarray, "m 3"]
    by_scene_point: Float64[np.ndarray, "m 3 3"]
    cost: float


def _linear(rays: Rays, state: State, noise: Noise, scale: float) -> _Linear:
    in_camera = points_in_cameras(rays, state)
    found = misfit(rays, in_camera)
    depth_sigma_m = noise.depth_ratio * found.depth_sigma_m
    residual = np.column_stack([found.error_px / noise.click_px, found.depth_error_m / depth_sigma_m])
    root_weight = (1 / (1 + np.column_stack(squared_errors(found, noise)) / scale**2))[:, [0, 0, 1]]

    gradient = camera_gradient(in_camera, found, rays.pixel_rad * noise.click_px, depth_sigma_m)
    by_scene_point = gradient @ rays.camera_from_scene[:, :3, :3]
    poses, points = state.scene_from_model[rays.scene], state.points_model[rays.keypoint]
    in_scene = transform_each(poses, points)
    by_turn, by_point = -by_scene_point @ cross_matrices(in_scene), by_scene_point @ poses[:, :3, :3]
    rows = np.concatenate([by_turn, by_scene_point, by_point], axis=2)
    return _Linear(rows, residual, root_weight, by_scene_point, float(click_costs(found, noise, scale).sum()))


def camera_gradient(
    in_camera: Float64[np.ndarray, "*b m 3"],
    found: Misfit,
    lateral_unit: Float64[np.ndarray, " m"],
    depth_unit: Float64[np.ndarray, "*b m"],
) -> Float64[np.ndarray, "*b m 3 3"]:
    """Derivative of the three normed residuals by the keypoint's position in the camera."""
    x, y = in_camera[..., 0], in_camera[..., 1]
    z = np.maximum(in_camera[..., 2], NEAREST_DEPTH_M)
    by_point = np.zeros((*z.shape, 2, 3))  # of xy
    by_point[..., 0, 0] = by_point[..., 1, 1] = 1 / z
    by_point[..., 0, 2], by_point[..., 1, 2] = -x / z**2, -y / z**2
    rows = np.empty((*z.shape, 3, 3))
    rows[..., :2, :] = by_point / lateral_unit[:, None, None]
    rows[..., 2, :] = -(found.slope_m[..., None, :] @ by_point)[..., 0, :]
    rows[..., 2, 2] += 1
    rows[..., 2, :] /= depth_unit[..., None]
    return rows


def reassign_keypoints(rays: Rays, state: State, candidates_model: list[Float64[np.ndarray, "_ 3"]]) -> State:
    """Put every keypoint at the cheapest of its present position and its candidates, scenes held fixed.

    The adjustment only slides along a ray to the next candidate depth; this jumps over the hill between.
    """
    points = state.points_model.copy()
    for k, candidates in enumerate(candidates_model):
        own = rays.keypoint == k
        if own.any() and len(candidates):
            tried = np.vstack([state.points_model[k][None], candidates])
            points[k] = tried[costs_of_positions(rays.of(own), state, tried).sum(axis=1).argmin()]
    return State(state.scene_from_model, points)


def costs_of_positions(
    rays: Rays, state: State, positions_model: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n m"]:
    """What positions of a keypoint cost each of its clicks, scenes held fixed, coarsely."""
    camera_from_model = rays.camera_from_scene @ state.scene_from_model[rays.scene]
    turned = (camera_from_model[:, :3, :3] @ positions_model.T).transpose(2, 0, 1)
    found = misfit(rays, turned + camera_from_model[:, :3, 3])
    lateral, depth = squared_errors(found, COARSE)
    costs: Float64[np.ndarray, "n m"] = (
        robust(lateral, 2 * KERNEL_SCALE_SIGMAS)
        + robust(depth)
        + FARTHER_SURFACE_PENALTY * (found.surface > 0)
    )
    return costs
