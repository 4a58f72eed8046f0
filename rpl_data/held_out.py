"""Parts of a surface that are left out of a fit, and how sure a gain on them is.

Points that lie near one another err alike. So whole blocks of space are left out, every other one as on a
chessboard, and each block counts once.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int64

from rpl_data.geometry import Points

FEWEST_BLOCKS = 3
"""With fewer, nothing is known of the scatter of their means."""


def blocks_of(points: Points, *, edge_m: float) -> Int64[np.ndarray, "n 3"]:
    """The block of space that each point lies in, by three numbers."""
    blocks: Int64[np.ndarray, "n 3"] = np.floor(points / edge_m).astype(np.int64)
    return blocks


def are_black(blocks: Int64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Whether blocks are black on a chessboard in space; blocks that share a face never are both."""
    black: Bool[np.ndarray, " n"] = blocks.sum(axis=1) % 2 == 0
    return black


def block_means(
    blocks: Int64[np.ndarray, "n d"], values: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " b"]:
    """Mean of the values in each block."""
    if not len(values):
        return np.zeros(0)
    number = np.unique(blocks, axis=0, return_inverse=True)[1].ravel()
    means: Float64[np.ndarray, " b"] = np.bincount(number, weights=values) / np.bincount(number)
    return means


def in_standard_errors(means: Float64[np.ndarray, " b"]) -> float:
    """Mean of the blocks' means over its standard error; 0 for fewer than `FEWEST_BLOCKS`."""
    if len(means) < FEWEST_BLOCKS:
        return 0.0
    return float(means.mean() / max(means.std(ddof=1) / np.sqrt(len(means)), 1e-9))
