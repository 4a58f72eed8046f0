"""A printed box."""

from __future__ import annotations

import cv2
import numpy as np

from rpl_data.twin import prints, surfaces, textures
from rpl_data.twin.objects.model import TwinObject, assembled
from rpl_data.twin.prints import GREEN, INK, PAPER, RED, YELLOW
from rpl_data.types import ColorImage

SIZE_M = (0.090, 0.060, 0.140)
CELLS = 14
"""Cells of each face's grid along each side; printed marks end on its lines."""


def carton() -> TwinObject:
    """Build a printed box, 90 x 60 x 140 mm, with six different faces; landmarks: corners and three marks."""
    x, y, z = SIZE_M
    faces = [_front(x, z), _back(x, z), _left(y, z), _right(y, z), _top(x, y), _bottom(x, y)]
    atlas, rects = textures.pack(faces)
    surface = surfaces.joined(surfaces.box(SIZE_M, rects, cells=CELLS, gloss=0.08), atlas)
    corners = {
        f"{height}_{depth}_{side}": (sx * x / 2, sy * y / 2, sz * z / 2)
        for height, sz in (("top", 1), ("bottom", -1))
        for depth, sy in (("front", -1), ("back", 1))
        for side, sx in (("left", -1), ("right", 1))
    }
    marks = {
        "band_end": (x / 2, -y / 2, z / 2 - 0.08),
        "nutrition_corner": (-x / 2, y / 2 - 12 / CELLS * y, z / 2 - 0.07),
        "brewing_corner": (x / 2 - 7 / CELLS * x, y / 2, z / 2 - 0.09),
    }
    apart = [(a, b) for a in corners for b in corners if a < b and _differ(a, b) == 1]
    return assembled("carton", surface, corners | marks, apart)


def _differ(one: str, other: str) -> int:
    """Count in how many of height, depth and side two corners differ; 1 for the ends of an edge."""
    return sum(a != b for a, b in zip(one.split("_"), other.split("_"), strict=True))


def _front(x: float, z: float) -> ColorImage:
    image = prints.sheet(x, z, YELLOW)
    image[320:] = RED
    cv2.circle(image, (215, 190), 105, PAPER, -1, cv2.LINE_AA)
    leaf = np.array([[215, 100], [275, 180], [225, 275], [165, 200]])
    cv2.fillPoly(image, [leaf], GREEN, cv2.LINE_AA)
    cv2.line(image, (215, 100), (225, 275), PAPER, 5, cv2.LINE_AA)
    prints.write(image, "OOLONG", (24, 405), 2.4, PAPER, 6)
    prints.write(image, "mountain tea", (30, 460), 1.2, PAPER)
    prints.write(image, "50 bags  125 g", (30, 530), 1.0, YELLOW)
    cv2.rectangle(image, (22, 22), (120, 62), INK, -1)
    prints.write(image, "NEW", (36, 54), 1.0, PAPER)
    return image


def _back(x: float, z: float) -> ColorImage:
    image = prints.sheet(x, z, PAPER)
    image[:90] = RED
    prints.write(image, "Brewing", (24, 62), 1.6, PAPER, 3)
    rng = np.random.default_rng(11)
    for line in range(12):
        cv2.line(image, (24, 125 + 20 * line), (int(rng.integers(200, 335)), 125 + 20 * line), INK, 4)
    cv2.rectangle(image, (26, 360), (180, 520), GREEN, -1)
    prints.write(image, "3 min", (38, 455), 1.2, PAPER)
    cv2.circle(image, (280, 455), 55, YELLOW, -1, cv2.LINE_AA)
    return image


def _left(y: float, z: float) -> ColorImage:
    image = prints.sheet(y, z, RED)
    cv2.rectangle(image, (34, 40), (206, 280), PAPER, -1)
    prints.write(image, "Nutrition", (42, 75), 0.9, INK)
    for line in range(7):
        cv2.line(image, (42, 100 + 22 * line), (198, 100 + 22 * line), INK, 2)
        prints.write(image, "0 g" if line % 2 else "12 kJ", (140, 96 + 22 * line), 0.45, INK, 1)
    prints.barcode(image, 45, 400, 150, 110)
    return image


def _right(y: float, z: float) -> ColorImage:
    image = prints.sheet(y, z, GREEN)
    for row in range(6):
        for column in range(3):
            at = (50 + 70 * column, 60 + 88 * row)
            color = YELLOW if (row * 3 + column) % 4 else RED
            cv2.ellipse(image, at, (22, 34), 25 * row + 15 * column, 0, 360, color, -1, cv2.LINE_AA)
    return image


def _top(x: float, y: float) -> ColorImage:
    image = prints.sheet(x, y, PAPER)
    cv2.fillPoly(image, [np.array([[0, 0], [150, 0], [60, 239], [0, 239]])], RED, cv2.LINE_AA)
    prints.write(image, "TEA", (165, 150), 2.2, INK, 5)
    return image


def _bottom(x: float, y: float) -> ColorImage:
    image = prints.sheet(x, y, (186, 160, 124))
    prints.write(image, "LOT 04-27", (40, 80), 1.2, INK)
    cv2.circle(image, (270, 170), 40, INK, 4, cv2.LINE_AA)
    cv2.rectangle(image, (40, 130), (140, 200), GREEN, -1)
    return image
