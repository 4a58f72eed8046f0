"""Print for the objects of a twin: sheets, lettering, bar codes, and marks placed on grids."""

from __future__ import annotations

import cv2
import numpy as np

from rpl_data.twin import textures
from rpl_data.twin.surfaces import Grid
from rpl_data.twin.textures import Rgb
from rpl_data.types import ColorImage

PX_PER_M = 4000
INK, PAPER, RED, GREEN, YELLOW = (38, 46, 84), (238, 234, 222), (196, 52, 46), (58, 128, 86), (240, 190, 60)
Mark = tuple[int, int, int, int]
"""Rows and columns of a grid that a printed mark spans: top, left, bottom, right."""


def sheet(width_m: float, height_m: float, color: Rgb) -> ColorImage:
    """A blank face, with the darker line of a fold."""
    image = np.full((round(height_m * PX_PER_M), round(width_m * PX_PER_M), 3), color, np.uint8)
    worn = tuple(int(0.8 * channel) for channel in color)
    cv2.rectangle(image, (0, 0), (image.shape[1] - 1, image.shape[0] - 1), worn, 5)
    return image


def write(image: ColorImage, text: str, at: tuple[int, int], size: float, color: Rgb, thick: int = 2) -> None:
    """Draw letters into the image; `at` is their lower left corner."""
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_DUPLEX, size, color, thick, cv2.LINE_AA)


def barcode(image: ColorImage, left: int, top: int, width: int, height: int) -> None:
    """Draw a bar code on white into the image."""
    cv2.rectangle(image, (left - 10, top - 10), (left + width + 10, top + height + 10), PAPER, -1)
    rng, u = np.random.default_rng(7), left
    while u < left + width:
        bar = int(rng.integers(3, 9))
        image[top : top + height, u : u + bar // 2 + 2] = (20, 20, 20)
        u += bar + 3


def small_print(image: ColorImage, left: int, top: int, width: int, lines: int, color: Rgb) -> None:
    """Draw lines too fine to read into the image."""
    rng = np.random.default_rng(left + top)
    for line in range(lines):
        end = left + int(width * rng.uniform(0.6, 1.0))
        cv2.line(image, (left, top + 16 * line), (end, top + 16 * line), color, 3)


def moulded(
    rng: np.random.Generator, height: int, width: int, color: Rgb, *, rough: float = 0.1
) -> ColorImage:
    """Plastic or painted metal of one colour, with grain and smudges of use."""
    grain = textures.fractal_noise(rng, height, width, cells=64, octaves=2)
    smudge = textures.fractal_noise(rng, height, width, cells=3, octaves=3)
    tone = 1 + rough * (0.5 * grain + 0.5 * smudge - 0.5)
    image: ColorImage = (np.array(color, np.float32) * tone[..., None]).clip(0, 255).astype(np.uint8)
    return image


def span_px(image: ColorImage, grid: Grid, mark: Mark) -> tuple[tuple[int, int], tuple[int, int]]:
    """Top left and bottom right pixel of a mark, in the picture that covers the whole grid."""
    rows, columns = grid.shape[0] - 1, grid.shape[1] - 1
    height, width = image.shape[:2]
    top, left, bottom, right = mark
    x0, x1 = (round(column / columns * (width - 1)) for column in (left, right))
    y0, y1 = (round(row / rows * (height - 1)) for row in (top, bottom))
    return (x0, y0), (x1, y1)


def panel(image: ColorImage, grid: Grid, mark: Mark, color: Rgb) -> tuple[tuple[int, int], tuple[int, int]]:
    """Fill a mark of the image with a colour, and return its two corners in pixels."""
    corners = span_px(image, grid, mark)
    cv2.rectangle(image, *corners, color, -1)
    return corners
