"""Masks measured in compiled code, beside pycocotools and the check of one mask."""

from __future__ import annotations

import numpy as np
import pytest
from pycocotools import mask as masks

from rpl_data.untrusted.compiled_rle import measured_masks
from rpl_data.untrusted.rle import pixels_of_rle


def random_masks(count: int) -> list[dict]:
    rng = np.random.default_rng(0)
    made = []
    for _ in range(count):
        shape, share = rng.integers(1, 30, 2), rng.choice([0.02, 0.3, 0.5, 0.9, 1.0])
        made.append(masks.encode(np.asfortranarray(rng.random(shape) < share, dtype=np.uint8)))
    return made


def test_they_are_those_of_pycocotools() -> None:
    given = random_masks(300)
    heights = np.array([mask["size"][0] for mask in given])
    found = measured_masks([mask["counts"].decode() for mask in given], heights)
    areas = np.array([masks.area(mask) for mask in given])
    assert (found.area == areas).all() and (areas > 0).mean() > 0.9
    boxes = np.array([masks.toBbox(mask) for mask in given])
    assert (found.box_xywh == boxes)[areas > 0].all()
    assert (found.pixels == [mask["size"][0] * mask["size"][1] for mask in given]).all()


def test_damaged_ones_are_refused_where_the_check_of_one_mask_refuses_them() -> None:
    rng = np.random.default_rng(1)
    refused = 0
    for mask in random_masks(100):
        text = list(mask["counts"].decode())
        text[rng.integers(len(text))] = chr(rng.integers(40, 120))
        damaged = "".join(text)
        try:
            pixels = pixels_of_rle(damaged)
        except ValueError:
            refused += 1
            with pytest.raises(ValueError):
                measured_masks(["02", damaged], np.array([2, 7]))
        else:
            assert measured_masks(["02", damaged], np.array([2, 7])).pixels.tolist() == [2, pixels]
    assert 10 < refused < 90
