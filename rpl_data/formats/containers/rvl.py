"""Unpack RVL, the run-length packing of depth that ROS writes as "compressedDepth rvl".

Depth, row by row, is a series of runs: how many pixels have none, how many have some, then those, each as the
difference from the last pixel that had some. Differences d are stored as 2 d, or -2 d - 1 where negative.
Every number is written three bits at a time, the lowest first, in the lower bits of a nibble whose highest
bit says that more follow. Eight nibbles make a 32-bit word, the first being its highest; words are
little-endian.
Sources: A. D. Wilson, Fast Lossless Depth Image Compression, SIGCHI 2017; rvl_codec.cpp of
compressed_depth_image_transport (ros-perception/image_transport_plugins).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Int64, UInt16

_MOST_NIBBLES = 11
"""No number is longer: 33 bits hold every run and every difference."""


def unpack_rvl(packed: bytes, pixels: int) -> UInt16[np.ndarray, " n"] | None:
    """The pixels of an image; None where the data is damaged or ends too early.

    Args:
        packed: the packed image.
        pixels: its number of pixels.
    """
    values = _numbers(packed)
    found = None if values is None else _runs(values, pixels)
    if values is None or found is None:
        return None
    starts, lengths, value_at = found
    within = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    stored = values[np.repeat(value_at, lengths) + within]
    depth = np.zeros(pixels, np.uint16)
    depth[np.repeat(starts, lengths) + within] = np.cumsum((stored >> 1) ^ -(stored & 1)).astype(np.uint16)
    return depth


def _numbers(packed: bytes) -> Int64[np.ndarray, " m"] | None:
    """All numbers of the series; None where one has too many nibbles."""
    words = np.frombuffer(packed[: len(packed) // 4 * 4], "<u4")
    nibbles = ((words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32)) & 15).ravel().astype(np.int64)
    last = np.flatnonzero(nibbles < 8)
    if not len(last):
        return None
    first = np.concatenate([[0], last[:-1] + 1])
    if (last - first).max() >= _MOST_NIBBLES:
        return None
    place = np.arange(last[-1] + 1) - np.repeat(first, last - first + 1)
    return np.asarray(np.add.reduceat((nibbles[: last[-1] + 1] & 7) << 3 * place, first), np.int64)


def _runs(values: Int64[np.ndarray, " m"], pixels: int) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Of each run of pixels with depth: its first pixel, its length, and where its values are."""
    runs, pixel, at = [], 0, 0
    while pixel < pixels:
        if at + 2 > len(values):
            return None
        empty, length = int(values[at]), int(values[at + 1])
        start, at = pixel + empty, at + 2
        if empty + length == 0 or start + length > pixels or at + length > len(values):
            return None
        runs.append((start, length, at))
        pixel, at = start + length, at + length
    starts, lengths, value_at = np.array(runs, np.int64).reshape(-1, 3).T
    return starts, lengths, value_at
