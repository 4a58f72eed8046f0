"""Pose graph optimisation: poses of many frames from measured relative poses of pairs.

Every edge is a measured relative pose with its information matrix. The sum of the squared errors is minimised
by Gauss-Newton, with robust Cauchy weights against wrong pairs (Grisetti et al., "A tutorial on graph-based
SLAM", IEEE ITS Magazine 2010). A weak prior on every pose fixes what pairs cannot: where the whole path lies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from rpl_data.geometry import Transform, invert
from rpl_data.motions import adjoint
from rpl_data.reconstruct.information import Information, motion_between, moved

ITERATIONS = 15
CONVERGED = 1e-6
"""The iteration ends after a step smaller than this, in radians and metres."""

KERNEL_SCALE_SIGMAS = 3.0
"""An edge whose error is this many standard deviations has half its weight."""


@dataclass(frozen=True)
class Edge:
    """The measured relative pose of a pair of frames.

    Attributes:
        first, second: `Frame.index` of the two frames.
        first_from_second: the relative pose.
        information: inverse covariance of the motion of the second camera that corrects it.
    """

    first: int
    second: int
    first_from_second: Transform
    information: Information


def optimise(
    poses: Mapping[int, Transform], edges: Sequence[Edge], *, prior: Information
) -> dict[int, Transform]:
    """Find the poses that agree best with the edges and the prior.

    Args:
        poses: `scene_from_camera` by frame: the start of the search and the mean of the prior.
        prior: information of the prior, the same for every pose.
    """
    row = {frame: number for number, frame in enumerate(poses)}
    found = {frame: pose.copy() for frame, pose in poses.items()}
    for _ in range(ITERATIONS):
        blocks, pull = _normal_equations(poses, found, edges, prior, row)
        step = _solve(blocks, pull)
        found = {frame: pose @ moved(step[6 * row[frame] :][:6]) for frame, pose in found.items()}
        if np.abs(step).max(initial=0.0) < CONVERGED:
            break
    return found


Blocks = dict[tuple[int, int], Information]
"""6x6 blocks of the normal matrix by row and column."""


def _normal_equations(
    start: Mapping[int, Transform],
    found: Mapping[int, Transform],
    edges: Sequence[Edge],
    prior: Information,
    row: Mapping[int, int],
) -> tuple[Blocks, Float64[np.ndarray, " m"]]:
    blocks: Blocks = {(r, r): prior.copy() for r in row.values()}
    pull = np.concatenate([prior @ motion_between(found[frame], start[frame]) for frame in row])
    for edge in edges:
        relative = invert(found[edge.first]) @ found[edge.second]
        error = motion_between(relative, edge.first_from_second)
        information = edge.information / (1 + error @ edge.information @ error / KERNEL_SCALE_SIGMAS**2)
        # A motion of the first camera is the opposite motion of the second, carried over to its axes.
        by_first = -adjoint(invert(relative))
        a, b = row[edge.first], row[edge.second]
        blocks[a, a] += by_first.T @ information @ by_first
        blocks[b, b] += information
        blocks[a, b] = blocks.get((a, b), np.zeros((6, 6))) + by_first.T @ information
        blocks[b, a] = blocks.get((b, a), np.zeros((6, 6))) + information @ by_first
        pull[6 * a : 6 * a + 6] += by_first.T @ information @ error
        pull[6 * b : 6 * b + 6] += information @ error
    return blocks, pull


def _solve(blocks: Blocks, pull: Float64[np.ndarray, " m"]) -> Float64[np.ndarray, " m"]:
    values = np.concatenate([block.ravel() for block in blocks.values()])
    corners = 6 * np.array(list(blocks))
    inner_rows, inner_columns = np.divmod(np.arange(36), 6)
    rows = (corners[:, :1] + inner_rows).ravel()
    columns = (corners[:, 1:] + inner_columns).ravel()
    matrix = coo_matrix((values, (rows, columns)), shape=(len(pull), len(pull))).tocsc()
    step: Float64[np.ndarray, " m"] = np.asarray(spsolve(matrix, pull))
    return step
