"""Which further click would lower the expected error of the keypoints in the scenes most.

Everything follows from the covariance of scenes and keypoints that the clicks so far give: a keypoint in
a scene is T_s Q_k, whose error does not depend on the frame the model is in, and one more click lowers the
covariance by a known amount whatever its pixel turns out to be (Kalman's update, rank 3).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import transform
from rpl_data.solve.bundle_adjustment import State, cross_matrices
from rpl_data.solve.click_rays import NEAREST_DEPTH_M, Noise, Rays
from rpl_data.types import Click, NextClick

USUAL_DEPTH_SIGMA_M = 0.008
"""Standard deviation of a depth beside a click, where no click so far has one."""
FARTHEST_OFF_AXIS = 0.45
"""Tangent of the angle from the optical axis up to which a keypoint is taken to be in the picture."""


def next_clicks(
    rays: Rays,
    state: State,
    noise: Noise,
    joint: Float64[np.ndarray, "u u"],
    covariance_in_scene: Float64[np.ndarray, "s k 3 3"],
    clicks: Sequence[Click],
    known: Sequence[int],
    *,
    most: int,
) -> tuple[NextClick, ...]:
    """Further clicks in frames that have some, those that lower the expected error most first.

    Args:
        joint: covariance of all unknowns, from the clicks so far.
        covariance_in_scene: of the keypoints' positions; it may hold more than follows from `joint`,
            which a click does not lower.
        clicks: in the order of `rays`.
        known: keypoints that have a position.
    """
    places = _places_by_unknowns(state, known)
    spread = places @ joint
    before = np.trace(covariance_in_scene[:, known], axis1=2, axis2=3)
    depth_sigma_m = noise.depth_ratio * _usual_depth_sigma_m(rays)
    found = []
    for m, k in _unclicked(clicks, known):
        s = int(rays.scene[m])
        seen = _seen_by(rays, state, m, k, rays.pixel_rad[m] * noise.click_px, depth_sigma_m)
        if seen is None:
            continue
        rows, columns = seen
        shared = spread[:, columns] @ rows.T
        gain = np.linalg.inv(np.eye(3) + rows @ joint[np.ix_(columns, columns)] @ rows.T)
        falls = ((shared @ gain) * shared).reshape(len(before), len(known), 9).sum(axis=2)
        after_mm = 1e3 * np.sqrt(np.maximum(before - falls, 0))
        gain_mm = float((1e3 * np.sqrt(before) - after_mm).mean())
        left_mm = float(np.sqrt((after_mm[s] ** 2).mean()))
        found.append(NextClick(clicks[m].scene, clicks[m].frame, k, gain_mm, left_mm))
    return tuple(sorted(found, key=lambda f: -f.gain_mm)[:most])


def _usual_depth_sigma_m(rays: Rays) -> float:
    """Stated deviation of the depths of the clicks so far."""
    stated = rays.depth_sigmas_m[:, 0] / rays.widening
    stated = stated[np.isfinite(stated)]
    return float(np.median(stated)) if len(stated) else USUAL_DEPTH_SIGMA_M


def _places_by_unknowns(state: State, known: Sequence[int]) -> Float64[np.ndarray, "p u"]:
    """Derivative of all keypoints in all scenes, three rows each, by all unknowns."""
    scenes = len(state.scene_from_model)
    unknowns = 6 * scenes + state.points_model.size
    places = np.zeros((scenes * len(known), 3, unknowns))
    for n, (s, k) in enumerate((s, k) for s in range(scenes) for k in known):
        rows, columns = _by_unknowns(state, s, k)
        places[n][:, columns] = rows
    return places.reshape(-1, unknowns)


def _unclicked(clicks: Sequence[Click], known: Sequence[int]) -> Iterator[tuple[int, int]]:
    """(a click in a frame, a keypoint that has no click in that frame)."""
    frames: dict[tuple[str, int], int] = {}
    for m, click in enumerate(clicks):
        frames.setdefault((click.scene, click.frame), m)
    clicked = {(click.scene, click.frame, click.keypoint) for click in clicks}
    for (scene, frame), m in frames.items():
        for k in known:
            if (scene, frame, k) not in clicked:
                yield m, k


def _by_unknowns(state: State, scene: int, keypoint: int) -> tuple[np.ndarray, np.ndarray]:
    """Derivative of a keypoint in a scene (3, 9) by that scene's turn and shift and by the keypoint."""
    pose = state.scene_from_model[scene]
    in_scene = transform(pose, state.points_model[keypoint])
    first = 6 * len(state.scene_from_model) + 3 * keypoint
    columns = np.concatenate([6 * scene + np.arange(6), first + np.arange(3)])
    return np.hstack([-cross_matrices(in_scene), np.eye(3), pose[:3, :3]]), columns


def _seen_by(
    rays: Rays, state: State, m: int, keypoint: int, click_rad: float, depth_sigma_m: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """What one more click in the frame of click m would measure, in standard deviations; None out of view."""
    scene = int(rays.scene[m])
    rows, columns = _by_unknowns(state, scene, keypoint)
    camera_from_model = rays.camera_from_scene[m] @ state.scene_from_model[scene]
    x, y, z = transform(camera_from_model, state.points_model[keypoint])
    if z < NEAREST_DEPTH_M or max(abs(x), abs(y)) > FARTHEST_OFF_AXIS * z:
        return None
    unit = z * click_rad
    measured = np.array(
        [[1 / unit, 0, -x / (z * unit)], [0, 1 / unit, -y / (z * unit)], [0, 0, 1 / depth_sigma_m]]
    )
    return measured @ rays.camera_from_scene[m][:3, :3] @ rows, columns
