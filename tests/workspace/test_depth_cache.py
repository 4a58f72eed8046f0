"""Packed depth images come back exactly, or not at all."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import zstandard

from rpl_data.types import Frame, Intrinsics, Scene
from rpl_data.workspace.depth_cache import (
    MAGIC,
    cached_reader,
    cached_window_reader,
    pack,
    unpack,
    unpack_into,
)

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


@pytest.mark.parametrize("image", IMAGES.values(), ids=IMAGES)
def test_a_window_is_read_alone_and_files_of_earlier_versions_whole(image: np.ndarray) -> None:
    height, width = image.shape
    window = (slice(height // 3, height // 3 + 1), slice(1, width - 1))
    found = np.full_like(image, 7)
    assert unpack_into(pack(image), found, window, unit=1.0)
    np.testing.assert_array_equal(found[window], image[window])
    steps = np.diff(image, prepend=np.uint16(0), axis=1)  # modulo 2^16
    earlier = zstandard.ZstdCompressor(write_checksum=True).compress(steps.tobytes())
    np.testing.assert_array_equal(unpack(earlier, height=height, width=width), image)
    assert unpack_into(earlier, found, window, unit=1.0) and (found[window] == image[window]).all()
    found[window] = 7
    assert (found == 7).all()
    assert unpack(earlier[:-2], height=height, width=width) is None
    assert unpack(earlier, height=height + 1, width=width) is None


def test_only_the_window_of_a_cached_image_is_made_metres(tmp_path: Path) -> None:
    units, window = IMAGES["noise"], (slice(20, 30), slice(40, 64))
    cv2.imwrite(str(tmp_path / "0.png"), units)
    frame = Frame(0, 0.0, tmp_path / "none.png", tmp_path / "0.png")
    scene = Scene("s", Intrinsics(50.0, 50.0, 31.5, 23.5, 64, 48), 0.001, (frame,))
    whole = cached_reader(tmp_path / "cache", scene, keep=True)(frame)
    (tmp_path / "0.png").unlink()  # from here on the cache has it alone
    found = np.zeros_like(whole)
    cached_window_reader(tmp_path / "cache", scene)(frame, window, found)
    np.testing.assert_array_equal(found[window], whole[window])
    found[window] = 0
    assert not found.any()


def test_broken_bytes_and_other_sizes_are_nothing() -> None:
    packed = pack(IMAGES["noise"])
    assert unpack(packed[:-7], height=48, width=64) is None
    assert unpack(packed[:40] + b"!" + packed[41:], height=48, width=64) is None
    assert unpack(packed, height=24, width=64) is None
    assert unpack(packed, height=47, width=64) is None  # as many bands
    assert unpack(b"", height=48, width=64) is None


def test_a_damaged_frame_that_says_it_is_huge_is_nothing() -> None:
    huge = zstandard.FRAME_HEADER + b"\xc0\x80" + (2**62).to_bytes(8, "little") + b"\x01\x00\x00"
    assert zstandard.frame_content_size(huge) == 2**62
    assert unpack(huge, height=16, width=64) is None
    header = np.array([MAGIC, 16, 64, len(huge)], "<u4").tobytes()
    assert unpack(header + huge, height=16, width=64) is None


def test_a_band_of_another_height_is_nothing() -> None:
    """Even where all bands together have the rows of the image."""
    bands = [zstandard.ZstdCompressor().compress(bytes(2 * 64 * rows)) for rows in (10, 22)]
    header = np.array([MAGIC, 32, 64, *np.cumsum([len(band) for band in bands])], "<u4").tobytes()
    assert unpack(header + b"".join(bands), height=32, width=64) is None


def test_smooth_depth_takes_a_fraction_of_its_size() -> None:
    rows, columns = np.mgrid[0:480, 0:640]
    smooth = (700 + rows // 3 + columns // 7).astype(np.uint16)
    assert len(pack(smooth)) < smooth.nbytes / 10
