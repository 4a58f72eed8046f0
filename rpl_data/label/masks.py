"""Masks stored for a window of an image: their boxes, run-length code and clean-up.

Outside its window (a slice of rows and one of columns) a mask is empty, so no full image is allocated.
"""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool

from rpl_data.types import Box, Rle

Window = tuple[slice, slice]
"""Rows and columns of an image."""
MaskPatch = Bool[np.ndarray, "h w"]


def box_of(mask: MaskPatch, window: Window) -> Box:
    """The smallest box, with COCO's edges, around a mask with at least one pixel."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    top, left = window[0].start, window[1].start
    x0, y0 = left + columns[0], top + rows[0]
    x1, y1 = left + columns[-1] + 1, top + rows[-1] + 1
    return float(x0), float(y0), float(x1), float(y1)


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


def encode(mask: MaskPatch, window: Window, *, width: int, height: int) -> Rle:
    """Encode the mask as COCO's run-length code of an image of that size; pycocotools decodes it.

    Runs are counted in the window only: encoding two whole images would take a fifth of the labelling time.
    """
    from pycocotools import mask as coco

    # A row of zeros below ends every run in its own column.
    columns = np.zeros((mask.shape[1], mask.shape[0] + 1), dtype=np.bool_)
    columns[:, :-1] = mask.T
    flat = columns.ravel()
    changes = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    if flat[0]:
        changes = np.concatenate([[0], changes])
    column, row = np.divmod(changes, columns.shape[1])
    edges = (window[1].start + column) * height + window[0].start + row  # they ascend
    twice = np.flatnonzero(edges[1:] == edges[:-1])
    # An end that is also a start: the run goes on at the top of the next column.
    edges = np.delete(edges, np.concatenate([twice, twice + 1]))
    counts = np.diff(edges, prepend=0, append=width * height)
    if len(edges) and edges[-1] == width * height:
        counts = counts[:-1]
    code = coco.frPyObjects({"size": [height, width], "counts": counts.tolist()}, height, width)
    return Rle(size=[height, width], counts=code["counts"].decode("ascii"))
