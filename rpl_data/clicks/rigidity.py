"""Test whether the clicks tie all scenes together rigidly (paper, "Selection of Keypoints").

Three shared, non-collinear keypoints tie a pair of scenes, but fewer can do when the graph of scenes and
keypoints as a whole is rigid. So the whole graph is searched for free motions. A free motion turns and shifts
each scene a little (w_s, v_s), displaces the keypoints (d_k), and yet changes no click:
``w_s x q_k + v_s = d_k`` for every click. All scenes moving together as one is always free; when nothing else
is, the graph is rigid. A scene is loose when some free motion moves it relative to the largest group of
scenes that no free motion moves apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.geometry import is_collinear
from rpl_data.motions import cross_matrices

LEVER = 0.02
"""A motion counts as free when it moves the clicks by less than this share of its own size. Clicks are good
to 2 mm on an object of 10 cm, so a rotation about a line cannot be observed when all keypoints lie that near
to it."""


def loose_scenes(points_model: Float64[np.ndarray, "k 3"], clicked: Bool[np.ndarray, "s k"]) -> list[int]:
    """Find the loose scenes: those that a free motion moves relative to the largest group of tied scenes.

    Args:
        points_model: keypoints, in any frame and scale; rows of keypoints never clicked are ignored.
        clicked: which scene saw which keypoint.
    """
    scenes = len(clicked)
    used = np.flatnonzero(clicked.any(axis=0))
    points = points_model[used] - points_model[used].mean(axis=0)
    points = points / max(float(np.abs(points).max()), 1e-9)
    jacobian = _constraints(points, clicked[:, used])
    squared, vectors = np.linalg.eigh(jacobian.T @ jacobian)  # an SVD's left vectors grow with the clicks
    free = vectors[: 6 * scenes, squared <= LEVER**2].T.reshape(-1, scenes, 6)
    return _outside_largest_group(free)


def generic_points(keypoints: int) -> Float64[np.ndarray, "k 3"]:
    """Points in general position, to test whether the pattern of clicks can tie the scenes at all."""
    return np.random.default_rng(0).uniform(-1, 1, (keypoints, 3))


def _constraints(points: np.ndarray, clicked: np.ndarray) -> np.ndarray:
    """The three equations ``w_s x q_k + v_s - d_k = 0`` of every click, as rows of a matrix."""
    scenes, keypoints = clicked.shape
    rows = np.zeros((int(clicked.sum()), 3, 6 * scenes + 3 * keypoints))
    for row, (s, k) in zip(rows, np.argwhere(clicked), strict=True):
        row[:, 6 * s : 6 * s + 3] = -cross_matrices(points[k])
        row[:, 6 * s + 3 : 6 * s + 6] = np.eye(3)
        row[:, 6 * scenes + 3 * k : 6 * scenes + 3 * k + 3] = -np.eye(3)
    return rows.reshape(-1, rows.shape[2])


def _outside_largest_group(free: Float64[np.ndarray, "n s 6"]) -> list[int]:
    """Scenes outside the largest group whose members move as one in every free motion."""
    scenes = free.shape[1]
    together = np.array(
        [
            [np.abs(free[:, a] - free[:, b]).max(initial=0) < 1e-6 + LEVER for b in range(scenes)]
            for a in range(scenes)
        ]
    )
    largest = together[together.sum(axis=1).argmax()]
    return [int(s) for s in np.flatnonzero(~largest)]


def describe_loose(
    loose: Sequence[int],
    clicked: Bool[np.ndarray, "s k"],
    scenes: Sequence[str],
    keypoints: Sequence[str],
    points_model: Float64[np.ndarray, "k 3"],
) -> str:
    """Say, for each loose scene, which keypoints it shares with the rest and what to click.

    Args:
        points_model: the positions that the scenes were found to be loose with.
    """
    lines = []
    for s in loose:
        rest = [r for r in range(len(scenes)) if r != s]
        shared = [int(k) for k in np.flatnonzero(clicked[s] & clicked[rest].any(axis=0))]
        names = ", ".join(keypoints[k] for k in shared) or "none"
        word = "keypoint" if len(shared) == 1 else "keypoints"
        reason = ""
        if len(shared) >= 3:
            straight = is_collinear(points_model[shared])
            reason = " and they lie (nearly) on a line" if straight else " and the rest is loose itself"
        lines.append(
            f"scene {scenes[s]} shares only {word} {names} with the rest{reason}; "
            "click at least 3 common, non-collinear keypoints"
        )
    return "\n".join(lines)
