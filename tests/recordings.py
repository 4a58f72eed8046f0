"""Small recordings for the tests of readers: images with a number in them, poses, a camera."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from rpl_data.geometry import from_rotvec
from rpl_data.types import Intrinsics

CAMERA = Intrinsics(50.0, 51.0, 31.5, 23.5, 64, 48)
LENS = (50.0, 51.0, 31.5, 23.5)


def poses(count: int) -> np.ndarray:
    """A camera that moves along x and turns about y; the first is the identity."""
    return np.array([from_rotvec(np.array([0, 0.1 * i, 0]), np.array([0.1 * i, 0, 0])) for i in range(count)])


def color_image(number: int) -> np.ndarray:
    """RGB: red says which frame it is, left half green, right half blue."""
    image = np.zeros((48, 64, 3), np.uint8)
    image[..., 0] = 10 * number
    image[:, :32, 1] = image[:, 32:, 2] = 200
    return image


def depth_image(number: int, unit: int = 700) -> np.ndarray:
    """Depth rises to the right; its top-left pixel says which frame it is; none in the last row."""
    image = np.tile(np.arange(64, dtype=np.uint16) + unit, (48, 1))
    image[0, 0] = unit + number
    image[-1] = 0
    return image


def write_color(path: Path, number: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), color_image(number)[..., ::-1])


def write_depth(path: Path, number: int, unit: int = 700) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), depth_image(number, unit))


def cut(path: Path, by: int = 20) -> None:
    """Leave off the last bytes of a file."""
    path.write_bytes(path.read_bytes()[:-by])
