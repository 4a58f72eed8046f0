"""A mug: concave, with a handle that the depth camera only partly sees."""

from __future__ import annotations

import cv2
import numpy as np

from rpl_data.twin import prints, surfaces, textures
from rpl_data.twin.objects.model import TwinObject, assembled
from rpl_data.twin.prints import INK, PAPER, RED, YELLOW
from rpl_data.twin.surfaces import Grid
from rpl_data.types import ColorImage

COLUMNS = 96
OUTER_RZ_M = [(0.0410, 0.094), (0.0405, 0.070), (0.0390, 0.035), (0.0370, 0.008), (0.0345, 0.0)]
INNER_RZ_M = [(0.0, 0.005), (0.028, 0.006), (0.0335, 0.012), (0.0360, 0.040), (0.0375, 0.094)]
RIM_RZ_M = [(0.0375, 0.094), (0.0383, 0.0955), (0.0402, 0.0955), (0.0410, 0.094)]
HANDLE_XZ_M = [(0.036, 0.078), (0.056, 0.080), (0.071, 0.070), (0.073, 0.048), (0.064, 0.028), (0.035, 0.020)]
HANDLE_RADIUS_M = 0.0055
PICTURE, PANEL = (4, 38, 15, 58), (7, 14, 12, 26)
GLAZE = (206, 214, 216)
INNER_MARK = (11, 40, 15, 52)
"""A mark below the rim on the inside, which a camera from above sees."""


def cup() -> TwinObject:
    """Build a mug, 95 mm high; its landmarks are on handle, picture, word panel and a mark inside."""
    outer = surfaces.lathe_grid(surfaces.smooth_path(OUTER_RZ_M, 21), columns=COLUMNS)
    inner = surfaces.lathe_grid(surfaces.smooth_path(INNER_RZ_M, 20), columns=COLUMNS)
    path = surfaces.smooth_path(HANDLE_XZ_M, 25)
    handle = surfaces.tube_grid(path, [HANDLE_RADIUS_M] * len(path), columns=24)
    rng = np.random.default_rng(31)
    glaze, inside = (prints.moulded(rng, 256, width, GLAZE, rough=0.06) for width in (256, 768))
    prints.panel(inside, inner, INNER_MARK, RED)
    atlas, (print_rect, glaze_rect, inside_rect) = textures.pack([_print(outer, rng), glaze, inside])
    rim = surfaces.lathe_grid(RIM_RZ_M, columns=COLUMNS)
    bottom = surfaces.lathe_grid([(0.0345, 0.0), (0.031, 0.002), (0.0, 0.002)], columns=COLUMNS)
    parts = [
        surfaces.patch(outer, print_rect, gloss=0.45),
        surfaces.patch(inner, inside_rect, gloss=0.45),
        *(surfaces.patch(grid, glaze_rect, gloss=0.45) for grid in (rim, bottom, handle)),
    ]
    lines = [
        ("picture_top_left", "picture_top_right"),
        ("picture_top_right", "picture_bottom_right"),
        ("picture_bottom_right", "picture_bottom_left"),
        ("picture_bottom_left", "picture_top_left"),
        ("handle_top", "handle_out"),
        ("handle_out", "handle_bottom"),
    ]
    return assembled("cup", surfaces.joined(parts, atlas), _landmarks(outer, inner, handle), lines)


def _landmarks(outer: Grid, inner: Grid, handle: Grid) -> dict[str, list[float]]:
    skin = handle.reshape(-1, 3)
    top, left, bottom, right = PICTURE
    return {
        "handle_top": skin[np.argmax(skin[:, 2])].tolist(),
        "handle_out": skin[np.argmax(skin[:, 0])].tolist(),
        "handle_bottom": skin[np.argmax(skin[:, 0] - 1.5 * skin[:, 2])].tolist(),
        "picture_top_left": outer[top, left].tolist(),
        "picture_top_right": outer[top, right].tolist(),
        "picture_bottom_left": outer[bottom, left].tolist(),
        "picture_bottom_right": outer[bottom, right].tolist(),
        "panel_top_left": outer[PANEL[0], PANEL[1]].tolist(),
        "panel_bottom_right": outer[PANEL[2], PANEL[3]].tolist(),
        "inner_mark": inner[INNER_MARK[2], INNER_MARK[1]].tolist(),
    }


def _print(outer: Grid, rng: np.random.Generator) -> ColorImage:
    image = prints.moulded(rng, 380, 1000, GLAZE, rough=0.06)
    image[-70:-50] = INK
    (x0, y0), (x1, y1) = prints.panel(image, outer, PICTURE, (70, 120, 170))
    cv2.circle(image, ((x0 + 2 * x1) // 3, y0 + 50), 26, YELLOW, -1, cv2.LINE_AA)
    hills = np.array([[x0, y1], [x0, y1 - 60], [(x0 + x1) // 2, y0 + 70], [x1, y1 - 40], [x1, y1]])
    cv2.fillPoly(image, [hills], (64, 104, 66), cv2.LINE_AA)
    (x0, y0), (_, y1) = prints.panel(image, outer, PANEL, RED)
    prints.write(image, "CAFE", (x0 + 12, (y0 + y1) // 2 + 14), 1.3, PAPER, 3)
    return image
