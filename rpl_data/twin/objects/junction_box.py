"""A junction box: four sides that differ only by a screw and a sticker."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from rpl_data.geometry import rigid
from rpl_data.twin import prints, surfaces, textures
from rpl_data.twin.objects.model import TwinObject, assembled
from rpl_data.twin.prints import INK, RED, YELLOW
from rpl_data.twin.surfaces import Surface, UvRect
from rpl_data.types import ColorImage

SIDE_M, HEIGHT_M = 0.096, 0.052
GREY, DARK = (168, 170, 168), (58, 60, 62)
CELLS = 12
SCREW_M, SCREW_RADIUS_M = 0.036, 0.006
GLAND_M = 0.014
STICKER_PX = (4, 8)
"""First and last cell, in both directions, of the sticker on the front."""


def junction_box() -> TwinObject:
    """Build a box of 96 x 96 x 52 mm with a gland on each side: a quarter turn hardly changes its look."""
    rng = np.random.default_rng(61)
    size = (SIDE_M, SIDE_M, HEIGHT_M)
    faces = [_side(rng, sticker=number == 0) for number in range(4)] + [_lid(rng), _side(rng, sticker=False)]
    atlas, rects = textures.pack([*faces, prints.moulded(rng, 64, 128, DARK, rough=0.4)])
    glands = [part for quarter in range(4) for part in _gland(quarter, rects[6])]
    parts = [*surfaces.box(size, rects[:6], cells=CELLS, gloss=0.12), *glands]
    h, z = SIDE_M / 2, HEIGHT_M / 2
    corners = {
        f"{height}_{number}": [sx * h, sy * h, sz * z]
        for height, sz in (("top", 1), ("bottom", -1))
        for number, (sx, sy) in enumerate([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    }
    low, high = (SIDE_M * (cell / CELLS - 0.5) for cell in STICKER_PX)
    marks = {
        "sticker_top": [high, -h, HEIGHT_M * (0.5 - 1 / CELLS)],
        "brass_screw": [SIDE_M * (10 / CELLS - 0.5), SIDE_M * (10 / CELLS - 0.5), z],
    }
    lines = [(f"{height}_{n}", f"{height}_{(n + 1) % 4}") for height in ("top", "bottom") for n in range(4)]
    lines += [(f"top_{n}", f"bottom_{n}") for n in range(4)]
    return assembled("junction_box", surfaces.joined(parts, atlas), corners | marks, lines)


def _gland(quarter: int, rect: UvRect) -> list[Surface]:
    """A cable gland: a short ring that sticks out of the side, and its dark end."""
    r, half = GLAND_M, SIDE_M / 2
    profiles = [
        [(0.0, half + 0.008), (0.008, half + 0.009), (0.8 * r, half + 0.009)],
        [(0.8 * r, half + 0.009), (r, half + 0.006), (r, half)],
    ]
    up_to_x = Rotation.from_euler("y", 90, degrees=True)
    turn = (Rotation.from_euler("z", 90 * quarter, degrees=True) * up_to_x).as_matrix()
    out = rigid(turn, np.zeros(3))
    parts = [surfaces.patch(surfaces.lathe_grid(p, columns=48), rect, gloss=0.15) for p in profiles]
    return [part.moved(out) for part in parts]


def _side(rng: np.random.Generator, *, sticker: bool) -> ColorImage:
    image = prints.moulded(rng, 208, 384, GREY, rough=0.1)
    image[:26] = prints.moulded(rng, 26, 384, (150, 152, 150))  # the lid's rim
    if sticker:
        first, last = (round(384 * cell / CELLS) for cell in STICKER_PX)
        cv2.rectangle(image, (first, 17), (last, 52), YELLOW, -1)
        prints.write(image, "IN", (first + 40, 46), 0.9, RED, 2)
    return image


def _lid(rng: np.random.Generator) -> ColorImage:
    """The lid seen from above, +y at the top: four screws, the one at +x +y made of brass."""
    image = prints.moulded(rng, 384, 384, GREY, rough=0.1)
    cv2.rectangle(image, (14, 14), (369, 369), (140, 142, 140), 3)
    for column, row in ((2, 2), (10, 2), (2, 10), (10, 10)):
        at = (round(384 * column / CELLS), round(384 * row / CELLS))
        color = (214, 160, 60) if (column, row) == (10, 2) else (96, 98, 100)
        cv2.circle(image, at, 22, color, -1, cv2.LINE_AA)
        cv2.line(image, (at[0] - 15, at[1] - 15), (at[0] + 15, at[1] + 15), (30, 30, 30), 5, cv2.LINE_AA)
    cv2.circle(image, (192, 192), 60, INK, 4, cv2.LINE_AA)
    prints.write(image, "IP65", (146, 206), 1.2, INK, 3)
    return image
