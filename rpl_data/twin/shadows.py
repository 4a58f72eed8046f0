"""Share shadow rays among the pixels of an image: each casts few, and uses its neighbours' results too."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int64

TILE = 8
"""Side of a square of pixels that each cast shadow rays in another direction; their mean is smooth
(interleaved sampling, Keller & Heidrich, 2001)."""


@lru_cache(maxsize=2)
def tiled(shape: tuple[int, int]) -> tuple[Float32[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """The point of the unit sphere that each pixel uses, and whether the pixel tests the lamp."""
    count = TILE * TILE // 2
    z = 1 - (np.arange(count) + 0.5) * 2 / count
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))  # Fibonacci lattice: even on the sphere
    points = np.stack([np.cos(turn) * np.sqrt(1 - z**2), np.sin(turn) * np.sqrt(1 - z**2), z], -1)
    lamp = np.indices((TILE, TILE)).sum(axis=0) % 2 == 0
    rng, tile = np.random.default_rng(0), np.zeros((TILE, TILE), np.int64)
    tile[lamp], tile[~lamp] = rng.permutation(count), rng.permutation(count)
    rows, columns = np.indices(shape) % TILE
    return points.astype(np.float32)[tile[rows, columns].ravel()], lamp[rows, columns].ravel()


def tile_means(
    values: Float32[np.ndarray, " n"],
    asked: Float32[np.ndarray, "n 2"],
    thing: Int64[np.ndarray, "height width"],
) -> Float32[np.ndarray, "height width 2"]:
    """Two means over the tile around each pixel, over pixels of the same surface that were tested."""
    sums = np.concatenate([asked * values[:, None], asked], axis=1).reshape(*thing.shape, 4)
    smooth = np.ones((*thing.shape, 2), np.float32)
    for part, mask in _parts(thing):
        total = cv2.blur(sums[part] * mask[..., None], (TILE + 1, TILE + 1))[mask]
        smooth[part][mask] = total[:, :2] / np.maximum(total[:, 2:], 1e-6)
    return smooth


def _parts(
    thing: Int64[np.ndarray, "height width"],
) -> Iterator[tuple[tuple[slice, slice], Bool[np.ndarray, "_ _"]]]:
    """The bounding box of every surface's pixels, and its pixels in that box."""
    order = np.argsort(thing.ravel().astype(np.int16), kind="stable")
    numbers, first = np.unique(thing.ravel()[order], return_index=True)
    for number, pixels in zip(numbers, np.split(order, first[1:]), strict=True):
        if number >= 0:
            columns = pixels % thing.shape[1]
            top, bottom = pixels[0] // thing.shape[1], pixels[-1] // thing.shape[1] + 1
            part = np.s_[top:bottom, columns.min() : columns.max() + 1]
            yield part, thing[part] == number
