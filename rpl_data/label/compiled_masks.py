"""Encode masks as COCO does and measure them, in compiled code; importing this module imports numba.

COCO counts pixels column by column: how many are empty, then how many are full, and so on. From the fourth
count on it keeps the difference to the count before the last, each in characters of five bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool

from rpl_data.compiled import compiled
from rpl_data.types import Box, Rle, Window

LONGEST = 7
"""Characters that a count of up to 2^31 pixels takes."""


@dataclass(frozen=True)
class EncodedMask:
    """A mask as labels hold it.

    Attributes:
        box: the smallest box, with COCO's edges, around its pixels; None where it has none.
    """

    rle: Rle
    pixels: int
    box: Box | None


def encoded(mask: Bool[np.ndarray, "h w"], window: Window, *, width: int, height: int) -> EncodedMask:
    """Encode and measure a mask that lies in a window of an image of that size, and is empty outside it."""
    top, left = window[0].start, window[1].start
    text, pixels, x0, y0, x1, y1 = _encode(mask.view(np.uint8), top, left, height, width)
    box = (float(left + x0), float(top + y0), float(left + x1 + 1), float(top + y1 + 1)) if pixels else None
    return EncodedMask(Rle(size=[height, width], counts=text.tobytes().decode("ascii")), pixels, box)


@compiled
def _encode(mask: Any, top: int, left: int, height: int, width: int) -> Any:
    rows, columns = mask.shape
    pixels, starts, y0, y1 = 0, 0, rows, -1
    filled = np.zeros(columns, np.uint8)
    for y in range(rows):
        above, in_row = mask[max(y - 1, 0)], 0
        for x in range(columns):
            here = mask[y, x]
            in_row += here
            starts += here & (1 - above[x])
            filled[x] |= here
        pixels += in_row
        if in_row:
            y0, y1 = min(y0, y), y
    for x in range(columns):
        starts += mask[0, x]
    x0, x1 = 0, columns - 1
    while x0 <= x1 and not filled[x0]:
        x0 += 1
    while x0 <= x1 and not filled[x1]:
        x1 -= 1
    text = np.empty(LONGEST * (2 * starts + 2), np.uint8)
    size, start, end = 0, 0, 0  # of the run that is open
    before, two_before, count = 0, 0, 0
    for x in range(x0, x1 + 1):
        y = y0
        while y <= y1:
            if not mask[y, x]:
                y += 1
                continue
            first = (left + x) * height + top + y
            while y <= y1 and mask[y, x]:
                y += 1
            if first > end or count == 0:  # else the run goes on at the top of this column
                if count > 0:
                    size = _append(text, size, end - start, two_before, count)
                    two_before, before, count = before, end - start, count + 1
                size = _append(text, size, first - end, two_before, count)
                two_before, before, count = before, first - end, count + 1
                start = first
            end = (left + x) * height + top + y
    if count > 0:
        size = _append(text, size, end - start, two_before, count)
        two_before, before, count = before, end - start, count + 1
    if width * height > end or count == 0:
        size = _append(text, size, width * height - end, two_before, count)
    return text[:size], pixels, x0, y0, x1, y1


@compiled
def _append(text: Any, size: int, run: int, two_before: int, count: int) -> int:
    """Append a count, the one with that number; gives the new size of the text."""
    value = run - two_before if count > 2 else run
    while True:
        low, value = value & 31, value >> 5
        ended = value == -1 if low & 16 else value == 0
        text[size] = 48 + (low if ended else low | 32)
        size += 1
        if ended:
            return size
