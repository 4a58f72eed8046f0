"""Fit again under another reading of the clicks, in a few milliseconds, and say what it costs.

The solver's loss lets a wrong click go after three standard deviations, which is right for an answer and
wrong for a judgement: it makes a large contradiction cost no more than a small one. Here the click loss
is much wider, so that the cost says how strongly the clicks contradict each other, while a depth, which
is often that of another surface, still lets go early.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from rpl_data.motions import cross_matrices, transform_each
from rpl_data.solve.bundle_adjustment import State, camera_gradient, moved, points_in_cameras
from rpl_data.solve.click_rays import FARTHER_SURFACE_PENALTY, HAND_SIGMA_PX, Rays, misfit, robust
from rpl_data.solve.sparse_normal import columns_of, put_together, solved_by_scenes

HAND_CLICKS = 10.0
"""How many clicks that belief is worth."""
CLICK_KERNEL_SIGMAS = 10.0
"""Geman-McClure's scale for clicks: a click costs at most 100."""
DEPTH_KERNEL_SIGMAS = 2.5
"""The same for depths: a wrong depth costs about 6, so that it is believed before a wrong click."""


class Reading(NamedTuple):
    """One way to read the clicks; M clicks.

    Attributes:
        keypoint: which keypoint each click is taken for.
        ray_used: whether the position of the click counts.
        depth_used: whether the depth beside it counts.
    """

    keypoint: Int64[np.ndarray, " m"]
    ray_used: Bool[np.ndarray, " m"]
    depth_used: Bool[np.ndarray, " m"]


class Fit(NamedTuple):
    """The minimum for one reading.

    Attributes:
        cost: summed robust cost; `click_cost` is the part of each click's position.
        rows: weighted Jacobian of each click (two rows of position, one of depth) by its scene's pose
            (rotation, translation) and its keypoint.
        residuals: weighted residuals, in standard deviations.
        columns: the unknown behind each column of `rows`.
        in_camera: each click's keypoint in the camera that was clicked, metres.
        sigma_px: standard deviation of a click in each axis that the costs are in.
        hold_points: whether the keypoints stayed where they were.
    """

    cost: float
    scene_from_model: Float64[np.ndarray, "s 4 4"]
    points_model: Float64[np.ndarray, "k 3"]
    click_cost: Float64[np.ndarray, " m"]
    rows: Float64[np.ndarray, "m 3 9"]
    residuals: Float64[np.ndarray, "m 3"]
    columns: Int64[np.ndarray, "m 9"]
    in_camera: Float64[np.ndarray, "m 3"]
    sigma_px: float
    hold_points: bool

    @property
    def unknowns(self) -> int:
        """Six per scene and three per keypoint."""
        return 6 * len(self.scene_from_model) + self.points_model.size


def read_as_named(rays: Rays) -> Reading:
    """The reading that takes every click at its word."""
    everything = np.ones(len(rays.scene), dtype=bool)
    return Reading(rays.keypoint, everything, everything)


def refit(
    rays: Rays,
    reading: Reading,
    scene_from_model: Float64[np.ndarray, "s 4 4"],
    points_model: Float64[np.ndarray, "k 3"],
    *,
    sigma_px: float = HAND_SIGMA_PX,
    hold_points: bool = False,
    most_steps: int = 25,
) -> Fit:
    """Adjust scenes and keypoints to a reading, from a start (Levenberg-Marquardt).

    Args:
        hold_points: move the scenes only; the model is known.
    """
    fit = _evaluate(rays, reading, scene_from_model, points_model, sigma_px, hold_points)
    normal, gradient = normal_matrix(fit)
    if not normal.any():  # no click is in use, so there is nothing to adjust
        return fit
    damping = 1e-4
    for _ in range(most_steps):
        floor = 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal))
        damped = normal + damping * np.diag(np.diag(normal)) + floor
        step = solved_by_scenes(damped, -gradient, len(scene_from_model))
        there = moved(State(fit.scene_from_model, fit.points_model), step)
        tried = _evaluate(rays, reading, *there, sigma_px, hold_points)
        if tried.cost >= fit.cost:
            damping *= 10
            if damping > 1e5:
                break
            continue
        finished = fit.cost - tried.cost < 1e-3
        fit, damping = tried, max(damping / 5, 1e-9)
        if finished:
            break
        normal, gradient = normal_matrix(fit)
    return fit


def normal_matrix(fit: Fit) -> tuple[Float64[np.ndarray, "u u"], Float64[np.ndarray, " u"]]:
    """Normal matrix and gradient; the frame of the model is free, so the matrix has rank u - 6 at most."""
    return put_together(fit.rows, fit.residuals, fit.columns, fit.unknowns)


def unknowns_covariance(fit: Fit) -> Float64[np.ndarray, "u u"]:
    """Covariance of scenes and keypoints, with the frame of the model fixed by all of them."""
    covariance: Float64[np.ndarray, "u u"] = np.linalg.pinv(
        normal_matrix(fit)[0], hermitian=True, rcond=1e-10
    )
    return covariance


def shown_sigma_px(fit: Fit) -> float:
    """The click noise that the residuals show, each raised by the share the fit has swallowed.

    The median of the squared residuals (1.386 for two axes of deviation 1) is not moved by a few wrong
    clicks; with few clicks the hand's usual noise has a say.
    """
    covariance = unknowns_covariance(fit)
    rows = fit.rows[:, :2]
    blocks = covariance[fit.columns[:, :, None], fit.columns[:, None, :]]
    free = np.clip(1 - np.einsum("mri,mij,mrj->m", rows, blocks, rows) / 2, 0.05, 1)
    used = rows.any(axis=(1, 2))
    squared = (fit.residuals[used, :2] ** 2).sum(axis=1) / free[used]
    shown = float(np.median(squared)) / 1.386 * fit.sigma_px**2
    weight = float(free[used].sum())
    return float(np.sqrt((HAND_CLICKS * HAND_SIGMA_PX**2 + weight * shown) / (HAND_CLICKS + weight)))


def costs_without(fit: Fit, groups: Sequence[Int64[np.ndarray, " _"]]) -> Float64[np.ndarray, " n"]:
    """By how much the cost of the clicks' positions would fall without each group (linearised).

    For the rows J and residuals r of a group and the covariance C of the unknowns this is
    ``r' (I - J C J')^-1 r``, the squared distance of the group from what all others predict (Cook and
    Weisberg, Residuals and influence in regression, 1982).
    """
    covariance = unknowns_covariance(fit)
    found = np.empty(len(groups))
    sizes = np.array([len(group) for group in groups])
    for size in np.unique(sizes):  # groups of one size at once
        chosen = np.flatnonzero(sizes == size)
        clicks = np.stack([groups[n] for n in chosen.tolist()])
        rows, columns = fit.rows[clicks], fit.columns[clicks]
        between = covariance[columns[:, :, None, :, None], columns[:, None, :, None, :]]
        shared = rows[:, :, None] @ between @ rows[:, None].swapaxes(3, 4)
        held, axes = np.linalg.eigh(shared.swapaxes(2, 3).reshape(len(chosen), 3 * size, 3 * size))
        along = axes.swapaxes(1, 2) @ fit.residuals[clicks].reshape(len(chosen), -1, 1)
        pulled = (along[..., 0] ** 2 * (1 / np.maximum(1 - held, 0.02) - 1)).sum(axis=1)
        found[chosen] = fit.click_cost[clicks].sum(axis=1) + pulled
    return found


def _evaluate(
    rays: Rays,
    reading: Reading,
    scene_from_model: Float64[np.ndarray, "s 4 4"],
    points_model: Float64[np.ndarray, "k 3"],
    sigma_px: float,
    hold_points: bool,
) -> Fit:
    named = rays._replace(keypoint=reading.keypoint)
    in_camera = points_in_cameras(named, State(scene_from_model, points_model))
    found = misfit(rays, in_camera)
    measured = reading.depth_used & (found.surface >= 0)
    depth_sigma_m = np.where(measured, found.depth_sigma_m, np.inf)
    lateral, depth = found.error_px / sigma_px, found.depth_error_m / depth_sigma_m
    squared = np.column_stack([(lateral**2).sum(axis=1), depth**2])
    scales = np.array([CLICK_KERNEL_SIGMAS, DEPTH_KERNEL_SIGMAS])
    click_cost = robust(squared[:, 0], scales[0]) * reading.ray_used
    depth_cost = robust(squared[:, 1], scales[1]) + FARTHER_SURFACE_PENALTY * (measured & (found.surface > 0))
    weight = 1 / (1 + squared / scales**2) * np.column_stack([reading.ray_used, measured])
    root_weight = weight[:, [0, 0, 1], None]

    gradient = root_weight * camera_gradient(in_camera, found, rays.pixel_rad * sigma_px, depth_sigma_m)
    poses = scene_from_model[rays.scene]
    points = points_model[reading.keypoint]
    in_scene = transform_each(poses, points)
    by_scene_point = gradient @ rays.camera_from_scene[:, :3, :3]
    by_turn = -by_scene_point @ cross_matrices(in_scene)
    by_point = by_scene_point @ poses[:, :3, :3] * (not hold_points)
    return Fit(
        cost=float((click_cost + depth_cost).sum()),
        scene_from_model=scene_from_model,
        points_model=points_model,
        click_cost=click_cost,
        rows=np.concatenate([by_turn, by_scene_point, by_point], axis=2),
        residuals=np.column_stack([lateral, depth]) * root_weight[:, :, 0],
        columns=columns_of(rays.scene, reading.keypoint, len(scene_from_model)),
        in_camera=in_camera,
        sigma_px=sigma_px,
        hold_points=hold_points,
    )
