"""Where an object with known keypoints may stand in a scene: all the answers its clicks allow, best first.

Triples of keypoints, each at one of its candidate positions, give poses in closed form; those that fit the
clicks best are refined. More than one may remain: three clicks with a wrong depth among them can fit nearly
as well another way round.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from rpl_data.motions import cross_matrices
from rpl_data.solve.bundle_adjustment import COARSE, camera_gradient
from rpl_data.solve.click_rays import KERNEL_SCALE_SIGMAS, Noise, Rays, click_costs, misfit, squared_errors
from rpl_data.solve.initial_guess import Hypotheses, kabsch_of_triples

REFINED = 8
"""Poses that are refined, of all that the triples give."""
TOLD_APART = 5
"""Poses that are refined to the end."""
DISTINCT_M = 0.01
"""Poses that put the keypoints nearer together than this (mean over the keypoints) are the same."""


class ScenePoses(NamedTuple):
    """Poses of one object in one scene, best first.

    Attributes:
        cost: robust cost of the scene's clicks at each.
    """

    scene_from_model: Float64[np.ndarray, "b 4 4"]
    cost: Float64[np.ndarray, " b"]


def likely_poses(
    rays: Rays,
    points_model: Float64[np.ndarray, "k 3"],
    candidates: Hypotheses,
    *,
    known_poses: Float64[np.ndarray, "p 4 4"],
    samples: int = 300,
) -> ScenePoses:
    """Distinct poses that fit the clicks of one scene, each refined, best first.

    Args:
        rays: clicks of that scene on keypoints that have a position.
        points_model: where the keypoints are; they are held.
        candidates: by keypoint, where in the scene it may be.
        known_poses: poses to refine besides those that the triples give.
    """
    shared = sorted(candidates.keys() & {int(k) for k in rays.keypoint})
    poses = known_poses
    if len(shared) >= 3:
        poses = np.concatenate([poses, _poses_of_triples(rays, points_model, candidates, shared, samples)])
    if not len(poses):
        return ScenePoses(np.zeros((0, 4, 4)), np.zeros(0))
    some = points_model[np.unique(rays.keypoint)]
    poses = refine_poses(rays, points_model, poses, noise=COARSE, steps=6)
    poses = _best(poses, _costs(rays, points_model, poses, COARSE), some, most=TOLD_APART).scene_from_model
    poses = refine_poses(rays, points_model, poses, noise=Noise())
    return _best(poses, _costs(rays, points_model, poses, Noise()), some, most=TOLD_APART)


def _poses_of_triples(
    rays: Rays, points_model: np.ndarray, candidates: Hypotheses, shared: list[int], samples: int
) -> Float64[np.ndarray, "b 4 4"]:
    """The best of the poses that triples of keypoints give."""
    known: Hypotheses = {k: points_model[k][None] for k in shared}
    poses = kabsch_of_triples(known, candidates, shared, samples=samples, random=np.random.default_rng(0))
    if not len(poses):
        return poses
    costs = _costs(rays, points_model, poses, COARSE)
    return _best(poses, costs, points_model[shared], most=REFINED).scene_from_model


def refine_poses(
    rays: Rays,
    points_model: Float64[np.ndarray, "k 3"],
    poses: Float64[np.ndarray, "b 4 4"],
    *,
    noise: Noise,
    steps: int = 12,
) -> Float64[np.ndarray, "b 4 4"]:
    """Levenberg-Marquardt on many poses of one scene at once, the points held."""
    damping = np.full(len(poses), 1e-3)
    cost, normal, right = _normal_equations(rays, points_model, poses, noise)
    for _ in range(steps):
        diagonal = np.diagonal(normal, axis1=1, axis2=2)
        ridge = damping[:, None] * diagonal + 1e-9 * diagonal.sum(axis=1, keepdims=True)
        step = np.linalg.solve(normal + ridge[:, :, None] * np.eye(6), -right[..., None])[..., 0]
        tried = np.tile(np.eye(4), (len(poses), 1, 1))
        tried[:, :3, :3] = Rotation.from_rotvec(step[:, :3]).as_matrix()
        tried[:, :3, 3] = step[:, 3:]
        tried = tried @ poses
        there, normal_there, right_there = _normal_equations(rays, points_model, tried, noise)
        better = there < cost
        poses = np.where(better[:, None, None], tried, poses)
        if (np.abs(cost - there) < 1e-5 * cost).all():
            break
        cost = np.where(better, there, cost)
        normal = np.where(better[:, None, None], normal_there, normal)
        right = np.where(better[:, None], right_there, right)
        damping = np.where(better, damping / 5, damping * 10)
    return poses


def _in_cameras(rays: Rays, points_model: np.ndarray, poses: np.ndarray) -> Float64[np.ndarray, "b m 3"]:
    camera_from_model = rays.camera_from_scene @ poses[:, None]
    points = points_model[rays.keypoint]
    in_camera: Float64[np.ndarray, "b m 3"] = (
        camera_from_model[..., :3, :3] @ points[..., None] + camera_from_model[..., :3, 3:]
    )[..., 0]
    return in_camera


def _costs(
    rays: Rays, points_model: np.ndarray, poses: np.ndarray, noise: Noise
) -> Float64[np.ndarray, " b"]:
    found = misfit(rays, _in_cameras(rays, points_model, poses))
    costs: Float64[np.ndarray, " b"] = click_costs(found, noise).sum(axis=1)
    return costs


def _normal_equations(
    rays: Rays, points_model: np.ndarray, poses: np.ndarray, noise: Noise
) -> tuple[Float64[np.ndarray, " b"], Float64[np.ndarray, "b 6 6"], Float64[np.ndarray, "b 6"]]:
    """Robust cost of each pose; weighted normal matrix and right side of its six unknowns."""
    in_camera = _in_cameras(rays, points_model, poses)
    found = misfit(rays, in_camera)
    depth_unit = noise.depth_ratio * found.depth_sigma_m
    rows = camera_gradient(in_camera, found, rays.pixel_rad * noise.click_px, depth_unit)
    by_point = rows @ rays.camera_from_scene[:, :3, :3]
    in_scene = points_model[rays.keypoint] @ np.swapaxes(poses[:, :3, :3], 1, 2) + poses[:, None, :3, 3]
    jacobian = np.concatenate([-by_point @ cross_matrices(in_scene), by_point], axis=-1)
    residual = np.concatenate(
        [found.error_px / noise.click_px, (found.depth_error_m / depth_unit)[..., None]], axis=-1
    )
    lateral, depth = squared_errors(found, noise)
    scale = KERNEL_SCALE_SIGMAS
    weight = np.stack([1 / (1 + lateral / scale**2) ** 2] * 2 + [1 / (1 + depth / scale**2) ** 2], axis=-1)
    flat = jacobian.reshape(len(poses), -1, 6)
    weighted = flat * weight.reshape(len(poses), -1, 1)
    normal: Float64[np.ndarray, "b 6 6"] = np.swapaxes(weighted, 1, 2) @ flat
    right = (np.swapaxes(weighted, 1, 2) @ residual.reshape(len(poses), -1, 1))[..., 0]
    return click_costs(found, noise).sum(axis=1), normal, right


def _best(
    poses: Float64[np.ndarray, "b 4 4"],
    costs: Float64[np.ndarray, " b"],
    points_model: Float64[np.ndarray, "n 3"],
    *,
    most: int,
) -> ScenePoses:
    """The cheapest pose of every group that puts the points at the same positions, at most so many groups."""
    positions = points_model @ np.swapaxes(poses[:, :3, :3], 1, 2) + poses[:, None, :3, 3]
    kept: list[int] = []
    left = np.argsort(costs, kind="stable")
    while len(left) and len(kept) < most:
        kept.append(int(left[0]))
        apart_m = np.linalg.norm(positions[left] - positions[left[0]], axis=2).mean(axis=1)
        left = left[apart_m > DISTINCT_M]
    return ScenePoses(poses[kept], costs[kept])
