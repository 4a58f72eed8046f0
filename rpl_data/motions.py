"""Rigid motions of single points, and how points answer to small motions, for whatever solves for poses.

A small motion is six numbers, a rotation vector w and a translation t along the axes of its frame: it moves a
point p by ``w x p + t``.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64


def transform_each(
    a_from_b: Float64[np.ndarray, "n 4 4"], points_b: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Move each point by its own transform."""
    moved: Float64[np.ndarray, "n 3"] = (a_from_b[:, :3, :3] @ points_b[..., None] + a_from_b[:, :3, 3:])[
        ..., 0
    ]
    return moved


def cross_matrices(vectors: Float64[np.ndarray, "*b 3"]) -> Float64[np.ndarray, "*b 3 3"]:
    """Matrices [v] with [v] w = v x w."""
    matrices = np.zeros((*vectors.shape, 3))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    matrices[..., 0, 1], matrices[..., 0, 2] = -z, y
    matrices[..., 1, 0], matrices[..., 1, 2] = z, -x
    matrices[..., 2, 0], matrices[..., 2, 1] = -y, x
    return matrices


def adjoint(b_from_a: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "6 6"]:
    """Takes a small motion along the axes of a to the one along those of b that moves things alike."""
    turn = b_from_a[:3, :3]
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = turn
    matrix[3:, :3] = cross_matrices(b_from_a[:3, 3]) @ turn
    return matrix
