"""Packed depth images come back exactly, or not at all."""

from __future__ import annotations

import numpy as np
import pytest

from rpl_data.workspace.depth_cache import pack, unpack

IMAGES = {
    "noise": np.random.default_rng(0).integers(0, 65536, (48, 64)).astype(np.uint16),
    "jumps": np.tile(np.array([0, 65535, 1, 40000], np.uint16), (5, 3)),
    "nothing": np.zeros((2, 3), np.uint16),
}


@pytest.mark.parametrize("image", IMAGES.values(), ids=IMAGES)
def test_round_trip(image: np.ndarray) -> None:
    height, width = image.shape
    found = unpack(pack(image), height=height, width=width)
    assert found is not None and found.dtype == np.uint16
    np.testing.assert_array_equal(found, image)


def test_broken_bytes_and_other_sizes_are_nothing() -> None:
    packed = pack(IMAGES["noise"])
    assert unpack(packed[:-7], height=48, width=64) is None
    assert unpack(packed[:40] + b"!" + packed[41:], height=48, width=64) is None
    assert unpack(packed, height=24, width=64) is None
    assert unpack(b"", height=48, width=64) is None


def test_smooth_depth_takes_a_fraction_of_its_size() -> None:
    rows, columns = np.mgrid[0:480, 0:640]
    smooth = (700 + rows // 3 + columns // 7).astype(np.uint16)
    assert len(pack(smooth)) < smooth.nbytes / 10
