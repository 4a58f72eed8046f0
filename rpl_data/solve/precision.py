"""Which further click would lower the expected error of the keypoints in the scenes most.

Everything follows from the covariance of scenes and keypoints that the clicks so far give: a keypoint in
a scene is T_s Q_k, whose error does not depend on the frame the model is in, and one more click lowers the
covariance by a known amount whatever its pixel turns out to be (Kalman's update, rank 3).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.motions import cross_matrices
from rpl_data.solve.bundle_adjustment import State
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
    pairs = np.array(list(_unclicked(clicks, known)), dtype=np.int64).reshape(-1, 2)
    depth_sigma_m = noise.depth_ratio * _usual_depth_sigma_m(rays)
    seen = _seen_by(rays, state, pairs, noise.click_px, depth_sigma_m)
    before = np.trace(covariance_in_scene[:, known], axis1=2, axis2=3)
    falls = _falls(state, joint, known, seen)
    after_mm = 1e3 * np.sqrt(np.maximum(before - falls, 0))
    gain_mm = (1e3 * np.sqrt(before) - after_mm).mean(axis=(1, 2))
    best = np.argsort(-gain_mm, kind="stable")[:most]
    found = []
    for n in best:
        m, k = seen.pairs[n]
        left_mm = float(np.sqrt((after_mm[n, rays.scene[m]] ** 2).mean()))
        found.append(NextClick(clicks[m].scene, clicks[m].frame, int(k), float(gain_mm[n]), left_mm))
    return tuple(found)


def _falls(
    state: State, joint: Float64[np.ndarray, "u u"], known: Sequence[int], seen: _Seen
) -> Float64[np.ndarray, "n s k"]:
    """By how much each click lowers the variance of each keypoint in each scene (Kalman's update)."""
    spread = _places_by_unknowns(state, known) @ joint
    turned = np.swapaxes(seen.rows, 1, 2)
    shared = np.swapaxes(spread[:, seen.columns], 0, 1) @ turned
    held = joint[seen.columns[:, :, None], seen.columns[:, None, :]]
    gain = np.linalg.inv(np.eye(3) + seen.rows @ held @ turned)
    falls = ((shared @ gain) * shared).reshape(len(seen.rows), len(state.scene_from_model), len(known), 9)
    summed: Float64[np.ndarray, "n s k"] = falls.sum(axis=3)
    return summed


def _usual_depth_sigma_m(rays: Rays) -> float:
    """Stated deviation of the depths of the clicks so far."""
    stated = rays.depth_sigmas_m[:, 0] / rays.widening
    stated = stated[np.isfinite(stated)]
    return float(np.median(stated)) if len(stated) else USUAL_DEPTH_SIGMA_M


def _places_by_unknowns(state: State, known: Sequence[int]) -> Float64[np.ndarray, "p u"]:
    """Derivative of all keypoints in all scenes, three rows each, by all unknowns."""
    scenes = len(state.scene_from_model)
    scene, keypoint = np.repeat(np.arange(scenes), len(known)), np.tile(known, scenes)
    rows, columns = _by_unknowns(state, scene, keypoint)
    places = np.zeros((len(scene), 3, 6 * scenes + state.points_model.size))
    np.put_along_axis(places, np.repeat(columns[:, None], 3, axis=1), rows, axis=2)
    return places.reshape(-1, places.shape[2])


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


def _by_unknowns(
    state: State, scene: Int64[np.ndarray, " n"], keypoint: Int64[np.ndarray, " n"]
) -> tuple[Float64[np.ndarray, "n 3 9"], Int64[np.ndarray, "n 9"]]:
    """Derivatives of keypoints in scenes by the scene's turn and shift and the keypoint; their columns."""
    poses = state.scene_from_model[scene]
    in_scene = _transformed(poses, state.points_model[keypoint])
    shift = np.tile(np.eye(3), (len(scene), 1, 1))
    first = 6 * len(state.scene_from_model) + 3 * keypoint
    columns = np.hstack([6 * scene[:, None] + np.arange(6), first[:, None] + np.arange(3)])
    return np.concatenate([-cross_matrices(in_scene), shift, poses[:, :3, :3]], axis=2), columns


def _transformed(
    poses: Float64[np.ndarray, "n 4 4"], points: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Each point by its own pose."""
    moved: Float64[np.ndarray, "n 3"] = np.einsum("nij,nj->ni", poses[:, :3, :3], points) + poses[:, :3, 3]
    return moved


class _Seen(NamedTuple):
    """Clicks that could be made; N of them.

    Attributes:
        pairs: a click in the same frame, and the keypoint.
        rows: derivative of what would be measured, in standard deviations, by the unknowns in `columns`.
    """

    pairs: Int64[np.ndarray, "n 2"]
    rows: Float64[np.ndarray, "n 3 9"]
    columns: Int64[np.ndarray, "n 9"]


def _seen_by(
    rays: Rays, state: State, pairs: Int64[np.ndarray, "n 2"], click_px: float, depth_sigma_m: float
) -> _Seen:
    """Those pairs whose keypoint is in the picture, with what a click there would measure."""
    m, keypoint = pairs.T
    camera_from_scene = rays.camera_from_scene[m]
    camera_from_model = camera_from_scene @ state.scene_from_model[rays.scene[m]]
    x, y, z = _transformed(camera_from_model, state.points_model[keypoint]).T
    inside = (z > NEAREST_DEPTH_M) & (np.maximum(np.abs(x), np.abs(y)) < FARTHEST_OFF_AXIS * z)
    unit = np.where(inside, z, 1.0) * rays.pixel_rad[m] * click_px
    by_point = np.zeros((len(m), 3, 3))
    by_point[:, 0, 0] = by_point[:, 1, 1] = 1 / unit
    by_point[:, :2, 2] = -np.column_stack([x, y]) / (np.where(inside, z, 1.0) * unit)[:, None]
    by_point[:, 2, 2] = 1 / depth_sigma_m
    rows, columns = _by_unknowns(state, rays.scene[m], keypoint)
    measured = by_point @ camera_from_scene[:, :3, :3] @ rows
    return _Seen(pairs[inside], measured[inside], columns[inside])
