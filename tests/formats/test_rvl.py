"""RVL, the packing of "compressedDepth rvl": an image worked out by hand, round trips, damage."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from bags import ALIGNED, COLOR, bag, stamp
from recordings import color_image, depth_image

from rpl_data.formats.containers.rvl import unpack_rvl
from rpl_data.formats.recordings.ros.read import read_bag
from rpl_data.formats.recordings.ros.wanted import Topics
from rpl_data.images import read_depth_m


def pack(image: np.ndarray) -> bytes:
    """As the paper's encoder does, one number after the other."""
    nibbles: list[int] = []

    def write(number: int) -> None:
        while True:
            nibbles.append(number & 7 | (8 if number >> 3 else 0))
            number >>= 3
            if not number:
                return

    values, at, previous = image.ravel().tolist(), 0, 0
    while at < len(values):
        start = next((n for n in range(at, len(values)) if values[n]), len(values))
        end = next((n for n in range(start, len(values)) if not values[n]), len(values))
        write(start - at)
        write(end - start)
        for value in values[start:end]:
            difference = value - previous
            write(2 * difference if difference >= 0 else -2 * difference - 1)
            previous = value
        at = end
    nibbles += [0] * (-len(nibbles) % 8)
    digits = "".join(f"{nibble:x}" for nibble in nibbles)
    return b"".join(struct.pack("<I", int(digits[n : n + 8], 16)) for n in range(0, len(digits), 8))


def test_an_image_worked_out_by_hand() -> None:
    """0 0 5 4 0: two pixels without depth, two with: +5 is 10 = 0b1_010, -1 is 1; one without, none with.

    Nibbles: 2, 2, a 1 (010 and more, then 001), 1, 1, 0 = 0x22a11100 with two to fill the word.
    """
    packed = bytes([0x00, 0x11, 0xA1, 0x22])
    np.testing.assert_array_equal(unpack_rvl(packed, 5), [0, 0, 5, 4, 0])
    assert pack(np.array([0, 0, 5, 4, 0])) == packed


def test_round_trips() -> None:
    chance = np.random.default_rng(0)
    noise = chance.integers(0, 65536, 5000)
    for image in (
        noise,
        noise * (chance.random(5000) < 0.5),
        np.zeros(70000, int),
        np.full(9, 65535),
        noise[:1],
    ):
        np.testing.assert_array_equal(unpack_rvl(pack(image), len(image)), image)


def test_damage_is_seen() -> None:
    image = np.arange(500, 900)
    packed = pack(image)
    assert unpack_rvl(packed[:-8], len(image)) is None
    assert unpack_rvl(packed, len(image) + 1) is None
    assert unpack_rvl(packed, len(image) - 1) is None
    assert unpack_rvl(b"", 4) is None and unpack_rvl(b"\xff" * 64, 4) is None
    assert unpack_rvl(bytes(64), 4) is None


@pytest.mark.parametrize("kind", ["16UC1", "32FC1"])
def test_a_topic_of_rvl(kind: str, tmp_path: Path) -> None:
    """Whole millimetres, and floats as A / z + B."""
    with bag(tmp_path / "a.bag") as writing:
        for number in range(3):
            units = depth_image(number)
            a, b = 101.0 * 100, 1 - 101.0 * 100 / 10
            if kind == "32FC1":
                metres = np.maximum(units, 1) / 1000
                stored = np.where(units > 0, a / metres + b, 0).astype(np.uint16)
            else:
                stored = units
            head = struct.pack("<iffII", 0, a, b, units.shape[1], units.shape[0])
            writing.info(f"{COLOR}/camera_info", stamp(number))
            writing.image(f"{COLOR}/image_raw", stamp(number), color_image(number), "rgb8")
            writing.compressed(
                f"{ALIGNED}/image_raw/compressedDepth",
                stamp(number),
                head + pack(stored),
                f"{kind}; compressedDepth rvl",
            )
    recording = read_bag("a", (tmp_path / "a.bag",), tmp_path / "out", None, None, Topics())
    for number, frame in enumerate(recording.scene.frames):
        expected = depth_image(number) / 1000
        step = 0.0005 if kind == "32FC1" else 1e-6  # inverse depth in whole numbers, then 0.25 mm
        np.testing.assert_allclose(read_depth_m(recording.scene, frame), expected, atol=step)
