"""How far off the keypoints of a scene should be, and which further click would lower that most.

Everything follows from the covariance of scenes and keypoints that the clicks so far give: a keypoint in
a scene is T_s Q_k, whose error does not depend on the frame the model is in, and one more click lowers the
covariance by a known amount whatever its pixel turns out to be (Kalman's update, rank 3).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import depth_sigma_m
from rpl_data.solve.explanations import Trial
from rpl_data.solve.refit import NEAREST_DEPTH_M, unknowns_covariance
from rpl_data.types import NextClick, Observation

LIFTED_SIGMA_M = 0.008
"""Standard deviation of a depth beside a click, besides the sensor's: corners fall away, edges bleed."""
FARTHEST_OFF_AXIS = 0.45
"""Tangent of the angle from the optical axis up to which a keypoint is taken to be in the picture."""


def expected_errors_m(trial: Trial, known: Sequence[int]) -> Float64[np.ndarray, "s k"]:
    """Standard deviation in space of each known keypoint in each scene, metres."""
    places = _places_by_unknowns(trial, known)
    return _deviations_m(places, places @ unknowns_covariance(trial.fit), len(known))


def next_clicks(
    trial: Trial, observations: Sequence[Observation], known: Sequence[int], *, most: int
) -> tuple[NextClick, ...]:
    """Further clicks in frames that have some, those that lower the expected error most first."""
    covariance = unknowns_covariance(trial.fit)
    places = _places_by_unknowns(trial, known)
    spread = places @ covariance
    before = _deviations_m(places, spread, len(known))
    found = []
    for m, s, k in _unclicked(trial, observations, known):
        seen = _seen_by(trial, m, s, k)
        if seen is None:
            continue
        rows, columns = seen
        shared = spread[:, columns] @ rows.T
        gain = np.linalg.inv(np.eye(3) + rows @ covariance[np.ix_(columns, columns)] @ rows.T)
        falls = ((shared @ gain) * shared).reshape(len(before), len(known), 9).sum(axis=2)
        after = np.sqrt(np.maximum(before**2 - falls, 0))
        click = observations[m].click
        gain_mm, left_mm = 1e3 * float((before - after).mean()), 1e3 * float(after[s].mean())
        found.append(NextClick(click.scene, click.frame, k, gain_mm, left_mm))
    return tuple(sorted(found, key=lambda f: -f.gain_mm)[:most])


def _places_by_unknowns(trial: Trial, known: Sequence[int]) -> Float64[np.ndarray, "p u"]:
    """Derivative of all keypoints in all scenes, three rows each, by all unknowns."""
    scenes = len(trial.fit.scene_from_model)
    places = np.zeros((scenes * len(known), 3, trial.fit.unknowns))
    for n, (s, k) in enumerate((s, k) for s in range(scenes) for k in known):
        rows, columns = _by_unknowns(trial, s, k)
        places[n][:, columns] = rows
    return places.reshape(-1, trial.fit.unknowns)


def _deviations_m(
    places: Float64[np.ndarray, "p u"], spread: Float64[np.ndarray, "p u"], known: int
) -> Float64[np.ndarray, "s k"]:
    """Root of the trace of each place's covariance."""
    variances = (places * spread).sum(axis=1).reshape(-1, known, 3).sum(axis=2)
    deviations: Float64[np.ndarray, "s k"] = np.sqrt(np.maximum(variances, 0))
    return deviations


def _unclicked(
    trial: Trial, observations: Sequence[Observation], known: Sequence[int]
) -> Iterator[tuple[int, int, int]]:
    """(a click in a frame, its scene, a keypoint that has no click in that frame)."""
    frames: dict[tuple[str, int], int] = {}
    for m, o in enumerate(observations):
        frames.setdefault((o.click.scene, o.click.frame), m)
    clicked = {(o.click.scene, o.click.frame, o.click.keypoint) for o in observations}
    for (scene, frame), m in frames.items():
        for k in known:
            if (scene, frame, k) not in clicked:
                yield m, int(trial.rays.scene[m]), k


def _by_unknowns(trial: Trial, scene: int, keypoint: int) -> tuple[np.ndarray, np.ndarray]:
    """Derivative of a keypoint in a scene (3, 9) by that scene's turn and shift and by the keypoint."""
    fit = trial.fit
    pose = fit.scene_from_model[scene]
    x, y, z = pose[:3, :3] @ fit.points_model[keypoint] + pose[:3, 3]
    turn = -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    by_point = pose[:3, :3] * (not fit.hold_points)
    first = 6 * len(fit.scene_from_model) + 3 * keypoint
    columns = np.concatenate([6 * scene + np.arange(6), first + np.arange(3)])
    return np.hstack([turn, np.eye(3), by_point]), columns


def _seen_by(trial: Trial, m: int, scene: int, keypoint: int) -> tuple[np.ndarray, np.ndarray] | None:
    """What one more click in the frame of click m would measure, in standard deviations; None out of view."""
    fit, rays = trial.fit, trial.rays
    rows, columns = _by_unknowns(trial, scene, keypoint)
    pose = fit.scene_from_model[scene]
    in_scene = pose[:3, :3] @ fit.points_model[keypoint] + pose[:3, 3]
    camera_from_scene = rays.camera_from_scene[m]
    x, y, z = camera_from_scene[:3, :3] @ in_scene + camera_from_scene[:3, 3]
    if z < NEAREST_DEPTH_M or max(abs(x), abs(y)) > FARTHEST_OFF_AXIS * z:
        return None
    unit = z * rays.pixel_rad[m] * fit.sigma_px
    depth_m = float(np.hypot(float(np.asarray(depth_sigma_m(np.array(z)))), LIFTED_SIGMA_M))
    measured = np.array([[1 / unit, 0, -x / (z * unit)], [0, 1 / unit, -y / (z * unit)], [0, 0, 1 / depth_m]])
    return measured @ camera_from_scene[:3, :3] @ rows, columns
