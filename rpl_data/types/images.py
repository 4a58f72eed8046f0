"""Decoded images, masks and boxes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from jaxtyping import Float32, UInt8, UInt16

DepthImage = Float32[np.ndarray, "height width"]
"""Metres along the optical axis; 0 = no depth."""

ColorImage = UInt8[np.ndarray, "height width 3"]
"""RGB."""

GreyImage = UInt8[np.ndarray, "rows columns"]
"""Brightness."""


class Rle(TypedDict):
    """A mask in COCO's compressed run-length encoding, JSON-ready (`counts` is ASCII text)."""

    size: list[int]
    counts: str


@dataclass(frozen=True)
class SquareBox:
    """The paper's box b = (x, y, h): an upright square around the keypoints, scaled by 1.5."""

    cx_px: float
    cy_px: float
    side_px: float


Box = tuple[float, float, float, float]
"""x0, y0, x1, y1 in pixels with COCO's edges: a mask of the one pixel (u, v) has box
(u, v, u + 1, v + 1)."""

DepthUnits = UInt16[np.ndarray, "height width"]

Window = tuple[slice, slice]
"""Rows and columns of an image."""
