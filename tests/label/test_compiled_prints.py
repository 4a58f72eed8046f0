"""The compiled comparison of a print with a frame, beside the same written with NumPy and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from rpl_data.geometry import back_project, from_rotvec, invert, project, transform
from rpl_data.label.compiled_edges import fill_motion
from rpl_data.label.print_alignment import INDEPENDENT, print_equations
from rpl_data.label.prints import Look, Print
from rpl_data.raycast import PixelTable
from rpl_data.types import Intrinsics

PINHOLE = Intrinsics(300.0, 310.0, 79.3, 59.6, 160, 120)
LENS = Intrinsics(300.0, 310.0, 79.3, 59.6, 160, 120, (0.1, -0.05, 0.001, 0.002))
POSE = from_rotvec(np.array([0.3, -0.2, 0.1]), np.array([0.01, 0.02, 0.4]))
CENTRE = np.array([0.0, 0.01, 0.45])


def random_look(rng: np.random.Generator) -> Look:
    """A smooth image whose part begins at column 12, row 7; the object's window touches its border."""
    levels = [gaussian_filter(rng.uniform(0, 2000, (110, 140)), 2).astype(np.float32) for _ in range(9)]
    depth_m = rng.uniform(0.449, 0.451, (100, 130)).astype(np.float32)
    inner = rng.random((100, 130)) < 0.9
    by_blur = tuple((levels[i], levels[i + 1], levels[i + 2]) for i in (0, 3, 6))
    return Look((12, 7), by_blur, (slice(17, 117), slice(22, 152)), depth_m, inner)


def random_print(rng: np.random.Generator, look: Look, camera: Intrinsics, *, number: int = 200) -> Print:
    """Points in and around the image, some off the mesh, one unknown and one behind the camera."""
    uv_px = rng.uniform((15, 5), (158, 118), (number, 2))
    points = back_project(camera, uv_px, rng.uniform(0.443, 0.457, number))
    shown = 0.7 * read(look, look.levels[1][0], uv_px) + 20 + rng.normal(0, 15, number)
    points[0], points[1] = np.nan, -points[1]
    return Print(transform(invert(POSE), points), np.tile(shown, (3, 1)))


def read(look: Look, patch: np.ndarray, uv_px: np.ndarray) -> np.ndarray:
    """As SciPy reads between pixels."""
    row_column = (uv_px - look.corner).T[::-1]
    return map_coordinates(patch.astype(float), row_column, order=1, mode="nearest")


def by_numpy(camera: Intrinsics, look: Look, found: Print, level: int) -> tuple[np.ndarray, np.ndarray]:
    """The equations of `print_equations`, as the text of the module has them."""
    points = transform(POSE, found.points)
    uv_px = project(camera, points)
    seen = np.zeros(len(points), bool)
    for number in np.flatnonzero(np.isfinite(uv_px).all(axis=1)):
        column, row = np.rint(uv_px[number]).astype(int) - (22, 17)
        if 0 <= column < 130 and 0 <= row < 100:
            off_m = abs(look.depth_m[row, column] - points[number, 2])
            seen[number] = look.inner[row, column] and off_m < 0.006
    grey, right, down = (read(look, patch, uv_px[seen]) for patch in look.levels[level])
    here, there = grey - np.median(grey), found.brightness[level][seen]
    there = there - np.median(there)
    gain = np.clip(np.median(np.abs(here)) / np.median(np.abs(there)), 0.5, 2)
    difference = gain * there - here
    motion = np.empty((len(difference), 2, 6))
    fill_motion(points[seen], CENTRE, camera.fx, camera.fy, motion)
    rows = right[:, None] * motion[:, 0] + down[:, None] * motion[:, 1]
    noise = max(1.4826 * np.median(np.abs(difference)), 2)
    weight = 1 / (1 + (difference / (3 * noise)) ** 2) ** 2 / noise**2
    with_offset = np.column_stack([rows, np.ones(len(rows))])
    whole, pull = with_offset.T @ (weight[:, None] * with_offset), with_offset.T @ (weight * difference)
    share = np.outer(whole[:6, 6], whole[6]) / whole[6, 6]
    return whole[:6, :6] - share[:, :6], pull[:6] - whole[:6, 6] * pull[6] / whole[6, 6]


@pytest.mark.parametrize("camera", [PINHOLE, LENS], ids=["pinhole", "lens"])
def test_equations_are_those_written_with_numpy(camera: Intrinsics) -> None:
    rng = np.random.default_rng(5)
    look = random_look(rng)
    found = random_print(rng, look, camera)
    for level in range(3):
        information, pull = print_equations(PixelTable.of(camera), look, found, POSE, CENTRE, level)
        expected = by_numpy(camera, look, found, level)
        scale = INDEPENDENT * np.abs(expected[0]).max()
        assert scale > 1
        np.testing.assert_allclose(information, INDEPENDENT * expected[0], rtol=1e-9, atol=1e-12 * scale)
        np.testing.assert_allclose(pull, INDEPENDENT * expected[1], rtol=1e-9, atol=1e-12 * scale)


def test_a_print_that_is_empty_unseen_or_plain_says_nothing() -> None:
    rng = np.random.default_rng(6)
    look, camera = random_look(rng), PixelTable.of(PINHOLE)
    found = random_print(rng, look, PINHOLE)
    unseen = [
        Print(np.zeros((0, 3)), np.zeros((3, 0))),
        Print(found.points + np.array([0.0, 0.0, 0.2]), found.brightness),
        Print(np.full_like(found.points, np.nan), found.brightness),
        Print(found.points, np.full_like(found.brightness, 80.0)),
        Print(found.points[:30], found.brightness[:, :30]),
    ]
    for one in unseen:
        information, pull = print_equations(camera, look, one, POSE, CENTRE, 0)
        assert not information.any()
        assert not pull.any()


def test_values_between_pixels_and_beyond_the_border_are_those_of_scipy() -> None:
    rng = np.random.default_rng(7)
    look = random_look(rng)
    uv_px = np.concatenate([rng.uniform(-20, 180, (300, 2)), [[12, 7], [151, 116], [151.5, 116.5]]])
    patch = look.levels[0][0]
    np.testing.assert_allclose(look.at(patch, uv_px), read(look, patch, uv_px), rtol=1e-6)
    assert look.at(patch, np.zeros((0, 2))).shape == (0,)
