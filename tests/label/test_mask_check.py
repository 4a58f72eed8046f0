"""Labels compared with given masks."""

from __future__ import annotations

import numpy as np
from labelled_scenes import rle

from rpl_data.label.mask_check import MaskCheck

HALVES = np.zeros((10, 20), bool)
HALVES[:, :10] = True


def test_the_ious_are_those_of_the_pixels() -> None:
    check = MaskCheck()
    shifted = np.roll(HALVES, 5, axis=1)  # 50 of 150 pixels in common
    for frame, given in enumerate([HALVES, HALVES, shifted, None, np.zeros_like(HALVES)]):
        check.add("cup", frame, rle(HALVES), given)
    check.add("cup", 9, rle(np.zeros_like(HALVES)), np.zeros_like(HALVES))  # neither shows it: nothing said
    assert check.ious["cup"] == {0: 1.0, 1: 1.0, 2: 1 / 3, 4: 0.0}
    found = check.details()["cup"]
    assert found == {"iou_median": 0.6667, "frames": 4, "missing": 1, "apart": [2, 4]}
    about, apart = check.lines("desk")
    assert "0.67 (median of 4 frames; 1 more have no given mask)" in about
    assert "of 2 frames disagree" in apart and "2, 4;" in apart


def test_masks_that_disagree_throughout_are_a_warning() -> None:
    check = MaskCheck()
    for frame in range(3):
        check.add("cup", frame, rle(HALVES), ~HALVES)
    assert check.lines("desk") == [
        "WARNING: scene desk: cup: IoU of labels with given masks is 0.00 (median of 3 frames): one of them "
        "is wrong; look at both"
    ]
