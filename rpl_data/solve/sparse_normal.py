"""Normal equations whose rows know one scene and one keypoint each: put together and solved by scenes.

No two scenes meet in a row, so their unknowns are eliminated scene by scene (the Schur complement, Triggs
et al., Bundle adjustment, section 6): what is left to solve has the size of the keypoints alone, and the cost
grows in proportion to the number of scenes.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64


def columns_of(
    scene: Int64[np.ndarray, " m"], keypoint: Int64[np.ndarray, " m"], scenes: int
) -> Int64[np.ndarray, "m 9"]:
    """The unknowns of each click: 6 of its scene, then 3 of its keypoint."""
    of_pose = 6 * scene[:, None] + np.arange(6)
    return np.concatenate([of_pose, 6 * scenes + 3 * keypoint[:, None] + np.arange(3)], axis=1)


def put_together(
    rows: Float64[np.ndarray, "m 3 9"],
    residual: Float64[np.ndarray, "m 3"],
    columns: Int64[np.ndarray, "m 9"],
    unknowns: int,
) -> tuple[Float64[np.ndarray, "u u"], Float64[np.ndarray, " u"]]:
    """Normal matrix and gradient of weighted rows and residuals."""
    turned = rows.swapaxes(1, 2)
    cells = unknowns * columns[:, :, None] + columns[:, None, :]
    normal = np.bincount(cells.ravel(), (turned @ rows).ravel(), unknowns**2)
    by_click = turned @ residual[..., None]
    gradient = np.bincount(columns.ravel(), by_click.ravel(), unknowns)
    # Without any click numpy counts in whole numbers.
    return normal.reshape(unknowns, unknowns).astype(np.float64), gradient.astype(np.float64)


def solved_by_scenes(
    normal: Float64[np.ndarray, "u u"], right: Float64[np.ndarray, " u"], scenes: int
) -> Float64[np.ndarray, " u"]:
    """The solution of a regular system in which scenes meet keypoints, but never one another."""
    poses = 6 * scenes
    number = np.arange(scenes)
    of_scenes = normal[:poses, :poses].reshape(scenes, 6, scenes, 6)[number, :, number]
    between = normal[:poses, poses:].reshape(scenes, 6, -1)
    sides = np.concatenate([between, right[:poses].reshape(scenes, 6, 1)], axis=2)
    eliminated = np.linalg.solve(of_scenes, sides)
    reduced = np.tensordot(between, eliminated, axes=((0, 1), (0, 1)))
    points = np.linalg.solve(normal[poses:, poses:] - reduced[:, :-1], right[poses:] - reduced[:, -1])
    moves = eliminated[..., -1] - eliminated[..., :-1] @ points
    return np.concatenate([moves.ravel(), points])


Parts = list[tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " c"]]]
"""Per scene: the numbers of its clicks, and of the unknowns that these depend on."""


def parts_by_scene(scene: Int64[np.ndarray, " m"], scenes: int, of_points: int) -> Parts:
    """The clicks of each scene that has some, and its six unknowns with those of all keypoints.

    Args:
        of_points: how many unknowns the keypoints are.
    """
    last = 6 * scenes + np.arange(of_points)
    return [
        (np.flatnonzero(scene == s), np.concatenate([6 * s + np.arange(6), last]))
        for s in np.unique(scene).tolist()
    ]


def normal_by_scenes(jacobian: Float64[np.ndarray, "m 3 u"], parts: Parts) -> Float64[np.ndarray, "u u"]:
    """The normal matrix of rows of which each scene's are 0 but at its part of the unknowns."""
    normal = np.zeros((jacobian.shape[2], jacobian.shape[2]))
    for clicks, columns in parts:
        rows = jacobian[clicks][:, :, columns].reshape(-1, len(columns))
        normal[np.ix_(columns, columns)] += rows.T @ rows
    return normal
