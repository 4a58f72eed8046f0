"""Masks stored for a window of an image: where two overlap, what reaches the border, clean-up.

Outside its window (a slice of rows and one of columns) a mask is empty, so no full image is allocated.
"""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool

from rpl_data.types import Box, Window

MaskPatch = Bool[np.ndarray, "h w"]


def reaches_border(box: Box, *, width: int, height: int) -> bool:
    """Whether a box touches the edge of the image, so that what it holds may extend beyond."""
    return box[0] <= 0 or box[1] <= 0 or box[2] >= width or box[3] >= height


def overlap(a: Window, b: Window) -> tuple[Window, Window] | None:
    """The common part of two windows, counted from the start of each; None when there is none."""
    row, row_end = max(a[0].start, b[0].start), min(a[0].stop, b[0].stop)
    column, column_end = max(a[1].start, b[1].start), min(a[1].stop, b[1].stop)
    if row >= row_end or column >= column_end:
        return None

    def within(window: Window) -> Window:
        top, left = window[0].start, window[1].start
        return slice(row - top, row_end - top), slice(column - left, column_end - left)

    return within(a), within(b)


def cleaned(mask: MaskPatch, operation: Literal["open", "close"], *, size_px: int) -> MaskPatch:
    """Remove specks ("open") or fill gaps ("close") narrower than `size_px`."""
    code = cv2.MORPH_OPEN if operation == "open" else cv2.MORPH_CLOSE
    changed = cv2.morphologyEx(mask.view(np.uint8), code, np.ones((size_px, size_px), np.uint8))
    return changed.view(np.bool_)
