"""Where a keypoint may be in a scene, from all its clicks there.

Each candidate depth of each click gives a candidate position. They are ranked by how many of the scene's
other clicks on the same keypoint support them: their rays pass close by, and they measured that depth too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import invert, transform
from rpl_data.solve.initial_guess import AGREE_M, Hypotheses
from rpl_data.types import Observation

RAY_PX = 8.0
"""A ray supports a position that it passes within this many pixels of (hand, eye and trajectory together)."""
MOST = 4
"""Candidate positions kept for each keypoint of a scene."""


def hypotheses_of_scene(observations: Sequence[Observation]) -> Hypotheses:
    """Ranked candidate positions of every keypoint clicked in one scene, scene frame.

    A keypoint with rays but without any depth is located by triangulation when the rays allow it.
    """
    by_keypoint: dict[int, list[Observation]] = {}
    for observation in observations:
        by_keypoint.setdefault(observation.click.keypoint, []).append(observation)
    hypotheses = {}
    for keypoint, group in by_keypoint.items():
        positions = _positions(group)
        if len(positions):
            scores = _support(positions, group)
            hypotheses[keypoint] = _distinct(positions[np.argsort(-scores, kind="stable")])
    return hypotheses


def _positions(group: Sequence[Observation]) -> Float64[np.ndarray, "n 3"]:
    """All candidate positions, scene frame; nearest surfaces first, then the triangulated one."""
    lifted = [
        (rank, transform(o.scene_from_camera, depth_m * o.ray_camera))
        for o in group
        for rank, depth_m in enumerate(o.depths_m)
    ]
    lifted.sort(key=lambda position: position[0])
    positions = [position for _, position in lifted]
    met = triangulate(group)
    return np.array([*positions, *([] if met is None else [met])]).reshape(-1, 3)


def triangulate(group: Sequence[Observation]) -> Float64[np.ndarray, "3"] | None:
    """The point nearest to all rays; None when they are too parallel to tell its depth, or meet behind."""
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for o in group:
        direction = o.scene_from_camera[:3, :3] @ o.ray_camera
        direction /= np.linalg.norm(direction)
        across = np.eye(3) - np.outer(direction, direction)
        normal += across
        right += across @ o.scene_from_camera[:3, 3]
    if np.linalg.eigvalsh(normal)[0] < len(group) * 0.01:  # about 6 degrees between the rays
        return None
    point: Float64[np.ndarray, "3"] = np.linalg.solve(normal, right)
    ahead = all(transform(invert(o.scene_from_camera), point)[2] > 0 for o in group)
    return point if ahead else None


def _support(
    positions: Float64[np.ndarray, "n 3"], group: Sequence[Observation]
) -> Float64[np.ndarray, " n"]:
    """Clicks whose ray passes by count 1, and 1 more when they measured that depth; far rays 0."""
    scores: Float64[np.ndarray, " n"] = np.zeros(len(positions))
    for o in group:
        in_camera = transform(invert(o.scene_from_camera), positions)
        z = in_camera[:, 2]
        ahead = z > 0
        xy = in_camera[:, :2] / np.where(ahead, z, 1.0)[:, None]
        miss_px = np.linalg.norm(xy - o.ray_camera[:2], axis=1) / o.pixel_rad
        agrees = np.abs(o.depths_m - z[:, None]) < AGREE_M
        # A person clicks the nearest surface.
        measured = np.where(agrees[:, :1].any(axis=1), 1.5, np.where(agrees.any(axis=1), 1.0, 0.0))
        scores += np.where(ahead & (miss_px < RAY_PX), 1 - 0.5 * miss_px / RAY_PX + measured, 0.0)
    return scores


def _distinct(positions: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "m 3"]:
    """The first of every group of near positions, in order, at most `MOST`."""
    kept: list[np.ndarray] = []
    for position in positions:
        if all(np.linalg.norm(position - other) > AGREE_M / 2 for other in kept):
            kept.append(position)
    return np.array(kept[:MOST])
