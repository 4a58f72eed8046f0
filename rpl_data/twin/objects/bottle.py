"""A bottle: a surface of revolution, whose orientation only its label shows."""

from __future__ import annotations

import numpy as np

from rpl_data.twin import prints, surfaces, textures
from rpl_data.twin.objects.model import TwinObject, assembled
from rpl_data.twin.prints import GREEN, INK, PAPER, RED, YELLOW
from rpl_data.twin.surfaces import Grid
from rpl_data.types import ColorImage

COLUMNS = 96
SHOULDER_RZ_M = [(0.0135, 0.165), (0.0135, 0.150), (0.024, 0.135), (0.033, 0.115), (0.034, 0.105)]
BODY_RZ_M = [(0.034, 0.105), (0.034, 0.012), (0.0325, 0.004), (0.030, 0.0)]
CAP_RZ_M = [(0.0155, 0.186), (0.016, 0.184), (0.016, 0.162), (0.0155, 0.160)]
LABEL = (2, 10, 17, 72)
"""The label goes two thirds around, so that its two upright edges are never seen together alike."""
CREST, STAMP, TAB = (5, 34, 12, 46), (3, 80, 7, 88), (2, 20, 7, 26)
GLASS, CAP = (34, 84, 62), (228, 120, 40)


def bottle() -> TwinObject:
    """Build a tea bottle, 186 mm high; its landmarks are corners of label, crest, stamp and the cap's tab."""
    body = surfaces.lathe_grid(surfaces.smooth_path(BODY_RZ_M, 21), columns=COLUMNS)
    shoulder = surfaces.lathe_grid(surfaces.smooth_path(SHOULDER_RZ_M, 13), columns=COLUMNS)
    cap = surfaces.lathe_grid(surfaces.smooth_path(CAP_RZ_M, 10), columns=COLUMNS)
    rng = np.random.default_rng(21)
    atlas, (body_rect, glass_rect, cap_rect, top_rect) = textures.pack(
        [_label(body), _shoulder(shoulder, rng), _cap(cap, rng), prints.moulded(rng, 120, 120, CAP)]
    )
    lid = surfaces.lathe_grid([(0.0, 0.1865), (0.008, 0.1865), (0.0155, 0.186)], columns=COLUMNS)
    bottom = surfaces.lathe_grid([(0.030, 0.0), (0.026, 0.002), (0.0, 0.003)], columns=COLUMNS)
    parts = [
        surfaces.patch(body, body_rect, gloss=0.3),
        surfaces.patch(shoulder, glass_rect, gloss=0.7),
        surfaces.patch(cap, cap_rect, gloss=0.25),
        surfaces.patch(lid, top_rect, gloss=0.25),
        surfaces.patch(bottom, glass_rect, gloss=0.7),
    ]
    lines = [
        ("label_top_left", "label_top_right"),
        ("label_top_right", "label_bottom_right"),
        ("label_bottom_right", "label_bottom_left"),
        ("label_bottom_left", "label_top_left"),
    ]
    return assembled("bottle", surfaces.joined(parts, atlas), _landmarks(body, shoulder, cap), lines)


def _landmarks(body: Grid, shoulder: Grid, cap: Grid) -> dict[str, list[float]]:
    top, left, bottom, right = LABEL
    return {
        "label_top_left": body[top, left].tolist(),
        "label_top_right": body[top, right].tolist(),
        "label_bottom_left": body[bottom, left].tolist(),
        "label_bottom_right": body[bottom, right].tolist(),
        "crest_top_left": body[CREST[0], CREST[1]].tolist(),
        "crest_bottom_right": body[CREST[2], CREST[3]].tolist(),
        "stamp_top_left": shoulder[STAMP[0], STAMP[1]].tolist(),
        "stamp_bottom_right": shoulder[STAMP[2], STAMP[3]].tolist(),
        "tab_top_left": cap[TAB[0], TAB[1]].tolist(),
        "tab_bottom_right": cap[TAB[2], TAB[3]].tolist(),
        "label_foot": body[bottom, (left + right) // 2].tolist(),
    }


def _label(body: Grid) -> ColorImage:
    image = np.full((420, 860, 3), GLASS, np.uint8)
    (x0, y0), (x1, y1) = prints.panel(image, body, LABEL, PAPER)
    image[y1 - 50 : y1, x0:x1] = RED
    middle = round((LABEL[1] + LABEL[3]) / 2 / COLUMNS * 859)
    image[y1 - 50 : y1, middle:x1] = YELLOW  # the foot of the label changes colour in its middle
    (a0, b0), (a1, b1) = prints.panel(image, body, CREST, GREEN)
    prints.write(image, "No.7", (a0 + 12, (b0 + b1) // 2 + 12), 1.1, PAPER, 2)
    prints.write(image, "LEMON", (x0 + 14, y0 + 80), 1.6, RED, 4)
    prints.write(image, "iced tea", (x0 + 14, y0 + 130), 1.2, INK, 2)
    prints.small_print(image, a1 + 20, b0 + 10, x1 - a1 - 40, 9, INK)
    prints.barcode(image, x1 - 110, y1 - 130, 80, 60)
    return image


def _shoulder(shoulder: Grid, rng: np.random.Generator) -> ColorImage:
    image = prints.moulded(rng, 220, 860, GLASS)
    (x0, y0), (_, y1) = prints.panel(image, shoulder, STAMP, PAPER)
    prints.write(image, "0427", (x0 + 2, (y0 + y1) // 2 + 8), 0.8, INK, 2)
    return image


def _cap(cap: Grid, rng: np.random.Generator) -> ColorImage:
    image = prints.moulded(rng, 160, 860, CAP)
    image[:, ::9] = (170, 84, 24)  # ribs
    prints.panel(image, cap, TAB, PAPER)
    return image
