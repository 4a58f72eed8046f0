"""COCO's compressed run-length encoding, looked at before pycocotools unpacks it: that trusts what it reads.

A mask is a list of run lengths. Each is stored in groups of 5 bits, the lowest first, as the characters "0"
to "o"; from the fourth run on, the difference to the run two before (`rleFrString` in maskApi.c of COCO).
"""

from __future__ import annotations

import numpy as np

FIRST = 48
"""The character that stands for zero."""
VALUE, NEGATIVE, MORE = 0x1F, 0x10, 0x20
LONGEST_GROUPS = 8
"""Of one number; an image of a terapixel needs no more."""


def pixels_of_rle(counts: str) -> int:
    """How many pixels all runs have together.

    Raises:
        ValueError: a character is none of the encoding, a number is cut off, or a run is negative.
    """
    if not counts:
        return 0
    codes = np.frombuffer(counts.encode("utf-8", "surrogatepass"), np.uint8).astype(np.int64) - FIRST
    ends = np.flatnonzero(codes & MORE == 0)
    if codes.min() < 0 or codes.max() >= 64 or not len(ends) or ends[-1] != len(codes) - 1:
        raise ValueError("a mask holds another character than its encoding has, or is cut off")
    starts = np.concatenate([[0], ends[:-1] + 1])
    groups = ends - starts + 1
    if groups.max() > LONGEST_GROUPS:
        raise ValueError("a run of a mask is longer than any image")
    place = np.arange(len(codes)) - np.repeat(starts, groups)
    runs = np.add.reduceat((codes & VALUE) << 5 * place, starts)
    runs -= np.where(codes[ends] & NEGATIVE, np.int64(1) << 5 * groups, 0)
    for first in (1, 2):
        runs[first::2] = np.cumsum(runs[first::2])
    if runs.min() < 0:
        raise ValueError("a run of a mask has a negative length")
    return int(runs.sum())
