"""Clicks as arrays of rays and candidate surfaces, and how well a position of each keypoint fits them.

A click says two things about its keypoint: it projects to the clicked pixel, and it lies on one of the
surfaces that the sensor measured there. Each candidate surface is a plane, so a keypoint beside its click
is compared with the depth of the plane where the keypoint is, not where the click is: on a slanted face the
error of a click in the image then does no harm to its depth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from rpl_data.geometry import invert
from rpl_data.solve.shared_errors import widening
from rpl_data.types import Observation

NEAREST_DEPTH_M = 0.05
"""No keypoint is nearer to a camera than this; guards divisions while a solver is under way."""
HAND_SIGMA_PX = 2.0
"""Standard deviation of a careful click in each axis, believed until the clicks show another."""
CLICK_SIGMA_PX = 2.5
"""The same with a little of the trajectory: what a search for the solution starts with."""
KERNEL_SCALE_SIGMAS = 3.0
"""Scale of Geman-McClure's robust loss, in standard deviations."""
FARTHER_SURFACE_PENALTY = 3.0
"""Added cost (in squared standard deviations) of a candidate that is not the nearest surface: a person
clicks what can be seen, so the background is taken only when the other clicks insist."""
REACH_PX = 10.0
"""A candidate's plane is continued this far from its click, no farther."""


class Rays(NamedTuple):
    """Observations as arrays; M clicks, C candidate surfaces. Missing candidates are NaN.

    Attributes:
        xy: where the ray meets the plane z = 1 of its camera.
        depth_sigmas_m: widened for what the clicks of one keypoint in one scene share (`shared_errors`).
        widening: by how much.
        depth_slopes_m: derivative of each candidate's depth by `xy`.
        frame: numbers that tell the frames of all scenes apart.
        strayed_m: how far the pose of the clicked frame strays, standard deviation per axis; 0 in a scene
            with clicks in one frame only, where that shifts the whole scene.
    """

    scene: Int64[np.ndarray, " m"]
    keypoint: Int64[np.ndarray, " m"]
    camera_from_scene: Float64[np.ndarray, "m 4 4"]
    xy: Float64[np.ndarray, "m 2"]
    pixel_rad: Float64[np.ndarray, " m"]
    depths_m: Float64[np.ndarray, "m c"]
    depth_sigmas_m: Float64[np.ndarray, "m c"]
    depth_slopes_m: Float64[np.ndarray, "m c 2"]
    widening: Float64[np.ndarray, " m"]
    frame: Int64[np.ndarray, " m"]
    strayed_m: Float64[np.ndarray, " m"]

    def of(self, chosen: Bool[np.ndarray, " m"]) -> Rays:
        """The rays of some clicks."""
        return Rays(*(column[chosen] for column in self))


class Noise(NamedTuple):
    """How far off clicks and depths are.

    Attributes:
        click_px: standard deviation of a click, per axis.
        depth_ratio: standard deviation of the depths, in units of what was stated for each.
    """

    click_px: float = CLICK_SIGMA_PX
    depth_ratio: float = 1.0


class Misfit(NamedTuple):
    """How positions of the keypoints in their cameras fit the clicks; any leading dimensions.

    Attributes:
        error_px: projection minus click.
        depth_error_m: keypoint minus the surface taken, along the line of sight; 0 where there is none.
        depth_sigma_m: stated deviation of that surface; infinite where there is none.
        slope_m: derivative of that surface's depth by `xy` of the keypoint.
        surface: number of the candidate taken; -1 where there is none.
    """

    error_px: Float64[np.ndarray, "*b m 2"]
    depth_error_m: Float64[np.ndarray, "*b m"]
    depth_sigma_m: Float64[np.ndarray, "*b m"]
    slope_m: Float64[np.ndarray, "*b m 2"]
    surface: Int64[np.ndarray, "*b m"]


def rays_of(
    observations: Sequence[Observation],
    scenes: Sequence[str],
    trajectory_sigma_m: Mapping[str, float] | None = None,
) -> Rays:
    """Observations as arrays.

    Args:
        trajectory_sigma_m: how far the poses of each scene stray, standard deviation per axis; 0 when absent.
    """
    number = {name: s for s, name in enumerate(scenes)}
    most = max((len(o.depths_m) for o in observations), default=0)
    shape = (len(observations), max(most, 1))
    depths, sigmas, slopes = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros((*shape, 2))
    for m, o in enumerate(observations):
        depths[m, : len(o.depths_m)] = o.depths_m
        sigmas[m, : len(o.depths_m)] = o.depth_sigmas_m
        if o.depth_slopes_m is not None:
            slopes[m, : len(o.depths_m)] = o.depth_slopes_m
    scene = np.array([number[o.click.scene] for o in observations], dtype=np.int64)
    keypoint = np.array([o.click.keypoint for o in observations], dtype=np.int64)
    frame = np.unique(
        np.column_stack([scene, [o.click.frame for o in observations]]), axis=0, return_inverse=True
    )[1].ravel()
    frames_of = np.array([len(np.unique(frame[scene == s])) for s in range(len(scenes))])
    strayed_m = trajectory_sigma_m or {}
    directions = np.stack([o.scene_from_camera[:3, :3] @ o.ray_camera for o in observations])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    widened = widening(scene, keypoint, directions, np.isfinite(depths[:, 0]))
    return Rays(
        scene=scene,
        keypoint=keypoint,
        camera_from_scene=invert(np.stack([o.scene_from_camera for o in observations])),
        xy=np.stack([o.ray_camera[:2] for o in observations]),
        pixel_rad=np.array([o.pixel_rad for o in observations]),
        depths_m=depths,
        depth_sigmas_m=sigmas * widened[:, None],
        depth_slopes_m=slopes,
        widening=widened,
        frame=frame,
        strayed_m=np.array([strayed_m.get(name, 0.0) for name in scenes])[scene] * (frames_of[scene] > 1),
    )


def misfit(rays: Rays, in_camera: Float64[np.ndarray, "*b m 3"]) -> Misfit:
    """Compare keypoints in the cameras of their clicks with the clicks; the cheapest surface is taken."""
    z = in_camera[..., 2]
    offset = in_camera[..., :2] / np.maximum(z, NEAREST_DEPTH_M)[..., None] - rays.xy
    reach = REACH_PX * rays.pixel_rad[:, None]
    within = np.minimum(np.maximum(offset, -reach), reach)
    # The inverse depth of a plane is linear in xy.
    slopes = rays.depth_slopes_m
    rise = within[..., :1] * slopes[..., 0] + within[..., 1:] * slopes[..., 1]
    depths = rays.depths_m / np.maximum(1 - rise / rays.depths_m, 0.5)
    error_m = z[..., None] - depths
    cost = robust((error_m / rays.depth_sigmas_m) ** 2)
    cost[..., 1:] += FARTHER_SURFACE_PENALTY
    taken = np.where(np.isfinite(cost), cost, np.inf).argmin(axis=-1)
    measured = np.isfinite(rays.depths_m[:, 0])
    click = np.arange(len(rays.xy))
    flat = depths.reshape(-1, depths.shape[-1])
    chosen = flat[np.arange(len(flat)), taken.ravel()].reshape(taken.shape)
    slope = slopes[click, taken] * ((chosen / rays.depths_m[click, taken]) ** 2)[..., None]
    return Misfit(
        error_px=offset / rays.pixel_rad[:, None],
        depth_error_m=np.where(measured, z - chosen, 0.0),
        depth_sigma_m=np.where(measured, rays.depth_sigmas_m[click, taken], np.inf),
        slope_m=np.where(measured[:, None] & (np.abs(offset) < reach), slope, 0.0),
        surface=np.where(measured, taken, -1),
    )


def robust(
    squared: Float64[np.ndarray, "*n"], scale: float = KERNEL_SCALE_SIGMAS
) -> Float64[np.ndarray, "*n"]:
    """Geman-McClure's loss of squared errors in standard deviations; never more than `scale` squared."""
    loss: Float64[np.ndarray, "*n"] = squared / (1 + squared / scale**2)
    return loss


def squared_errors(found: Misfit, noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Squared errors of the click and of the depth, in standard deviations; each (..., M)."""
    lateral = (found.error_px[..., 0] ** 2 + found.error_px[..., 1] ** 2) / noise.click_px**2
    return lateral, (found.depth_error_m / (noise.depth_ratio * found.depth_sigma_m)) ** 2


def click_costs(
    found: Misfit, noise: Noise, scale: float = KERNEL_SCALE_SIGMAS
) -> Float64[np.ndarray, "*b m"]:
    """Robust cost of every click: of its pixel, of its depth, and of the surface taken."""
    lateral, depth = squared_errors(found, noise)
    costs: Float64[np.ndarray, "*b m"] = (
        robust(lateral, scale) + robust(depth, scale) + FARTHER_SURFACE_PENALTY * (found.surface > 0)
    )
    return costs
