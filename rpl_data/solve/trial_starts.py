"""Where the fit of another reading may start: a scene placed anew by its own clicks."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import invert, transform
from rpl_data.motions import transform_each
from rpl_data.solve.initial_guess import match
from rpl_data.solve.procrustes import kabsch_stack
from rpl_data.solve.refit import Reading
from rpl_data.solve.trial import Clicks, Trial


def scene_anew(trial: Trial, reading: Reading, scene: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """A start with one scene fitted to the model by the nearest depths of its clicks (robust Kabsch).

    Empty when fewer than three of its keypoints have a depth.
    """
    rays, fit = trial.rays, trial.fit
    own = np.flatnonzero(reading.ray_used & (rays.scene == scene) & np.isfinite(rays.depths_m[:, 0]))
    if len(np.unique(reading.keypoint[own])) < 3:
        return []
    lifted = lifted_in_scene(trial, own)[None]
    model = fit.points_model[reading.keypoint[own]][None]
    weights = np.ones((1, len(own)))
    for _ in range(4):
        placed = kabsch_stack(model, lifted, weights)
        gaps_m = np.linalg.norm(transform(placed[0], model[0]) - lifted[0], axis=1)
        weights = 1 / (1 + (gaps_m / 0.02) ** 2)[None] ** 2
    moved = fit.scene_from_model.copy()
    moved[scene] = placed[0]
    return [(moved, fit.points_model)]


def scene_matched(trial: Trial, reading: Reading, scene: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """A start with one scene placed by the three of its clicks, at any depth, that most others agree with."""
    rays, fit = trial.rays, trial.fit
    places: dict[int, list[np.ndarray]] = {}
    for click in np.flatnonzero(reading.ray_used & (rays.scene == scene)):
        scene_from_camera = invert(rays.camera_from_scene[click])
        for depth_m in rays.depths_m[click][np.isfinite(rays.depths_m[click])][:2]:
            in_camera = depth_m * np.append(rays.xy[click], 1.0)
            places.setdefault(int(reading.keypoint[click]), []).append(
                transform(scene_from_camera, in_camera)
            )
    trusted = reading.ray_used & ((rays.scene != scene) | fit.hold_points)
    model = {int(k): fit.points_model[k][None] for k in np.unique(reading.keypoint[trusted])}
    found = match(
        model, {k: np.array(p[:4]) for k, p in places.items()}, samples=150, random=np.random.default_rng(0)
    )
    if found is None:
        return []
    moved = fit.scene_from_model.copy()
    moved[scene] = found
    return [(moved, fit.points_model)]


def lifted_in_scene(trial: Trial, clicks: Clicks) -> Float64[np.ndarray, "n 3"]:
    """Clicks at their nearest surface, in their scenes; at their keypoint's depth where there is none."""
    rays = trial.rays
    measured_m = rays.depths_m[clicks, 0]
    depth_m = np.where(np.isfinite(measured_m), measured_m, trial.fit.in_camera[clicks, 2])
    in_camera = depth_m[:, None] * np.column_stack([rays.xy[clicks], np.ones(len(clicks))])
    return transform_each(invert(rays.camera_from_scene[clicks]), in_camera)
