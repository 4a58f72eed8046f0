"""A cordless drill: thin and concave, black and yellow, partly shiny."""

from __future__ import annotations

import cv2
import numpy as np

from rpl_data.twin import prints, surfaces, textures
from rpl_data.twin.objects.model import TwinObject, assembled
from rpl_data.twin.prints import PAPER, RED
from rpl_data.twin.surfaces import Grid, Surface
from rpl_data.types import ColorImage

YELLOW, BLACK, STEEL = (222, 170, 34), (36, 36, 38), (120, 122, 126)
AXIS_Z_M = 0.165
HOUSING_X_R_M = [
    (-0.080, 0.004), (-0.078, 0.024), (-0.060, 0.030), (-0.010, 0.031), (0.030, 0.027), (0.048, 0.021),
]  # fmt: skip
CHUCK_X_R_M = [(0.046, 0.020), (0.052, 0.021), (0.072, 0.018), (0.088, 0.011), (0.090, 0.004)]
BIT_X_R_M = [(0.088, 0.003), (0.128, 0.003), (0.136, 0.0005)]
GRIP_M = [
    (0.150, -0.020, 0.0, 0.024, 0.019), (0.125, -0.024, 0.0, 0.019, 0.017),
    (0.090, -0.030, 0.0, 0.018, 0.018), (0.060, -0.036, 0.0, 0.019, 0.018),
    (0.040, -0.038, 0.0, 0.026, 0.021),
]  # fmt: skip
BATTERY_SIZE_M, BATTERY_CENTRE_M = (0.110, 0.066, 0.042), (-0.030, 0.0, 0.021)
TRIGGER_SIZE_M, TRIGGER_CENTRE_M = (0.016, 0.014, 0.030), (0.002, 0.0, 0.122)
COLUMNS = 64
BADGE, PLATE = (8, 12, 18, 22), (8, 44, 14, 52)
"""Badge and plate on the two flanks of the housing; rows run from its front to its back."""


def drill() -> TwinObject:
    """Build a cordless drill, 216 mm from back to bit; landmarks on bit, battery, trigger and badges."""
    housing = _turned(HOUSING_X_R_M, 27)
    rng = np.random.default_rng(41)
    body, black, red, steel, pack = (
        _housing(housing, rng),
        prints.moulded(rng, 200, 200, BLACK, rough=0.5),
        prints.moulded(rng, 64, 64, RED),
        _knurled(rng),
        _pack(rng),
    )
    atlas, rects = textures.pack([body, black, red, steel, pack])
    grip = surfaces.loft_grid(surfaces.smooth_path(GRIP_M, 18), roundness=3.0)
    battery = surfaces.box(BATTERY_SIZE_M, [rects[4]] * 6, centre_m=BATTERY_CENTRE_M, cells=6, gloss=0.1)
    trigger = surfaces.box(TRIGGER_SIZE_M, [rects[2]] * 6, centre_m=TRIGGER_CENTRE_M, cells=3, gloss=0.2)
    parts: list[Surface] = [
        surfaces.patch(housing, rects[0], gloss=0.2),
        surfaces.patch(_turned(CHUCK_X_R_M, 13), rects[3], gloss=0.6),
        surfaces.patch(_turned(BIT_X_R_M, 9), rects[3], gloss=0.8),
        surfaces.patch(grip, rects[1], gloss=0.05),
        *battery,
        *trigger,
    ]
    lines = [
        ("battery_front_left_low", "battery_front_right_low"),
        ("battery_front_right_low", "battery_back_right_low"),
        ("battery_back_right_low", "battery_back_left_low"),
        ("battery_back_left_low", "battery_front_left_low"),
    ]
    return assembled("drill", surfaces.joined(parts, atlas), _landmarks(housing), lines)


def _landmarks(housing: Grid) -> dict[str, list[float]]:
    corners = {
        f"battery_{end}_{side}_{height}": [
            c + sign * s / 2
            for c, s, sign in zip(BATTERY_CENTRE_M, BATTERY_SIZE_M, (sx, sy, sz), strict=True)
        ]
        for end, sx in (("front", 1), ("back", -1))
        for side, sy in (("left", 1), ("right", -1))
        for height, sz in (("low", -1), ("top", 1))
        if height == "low" or (end == "front") == (side == "left")
    }
    tip, (x, y, z) = _turned(BIT_X_R_M, 9)[0], TRIGGER_CENTRE_M
    half_x, half_z = TRIGGER_SIZE_M[0] / 2, TRIGGER_SIZE_M[2] / 2
    return corners | {
        "bit_tip": tip[np.argmax(tip[:, 2])].tolist(),
        "trigger_left_low": [x + half_x, y + TRIGGER_SIZE_M[1] / 2, z - half_z],
        "badge_front": housing[BADGE[0], BADGE[1]].tolist(),
        "badge_back": housing[BADGE[2], BADGE[3]].tolist(),
        "plate_front": housing[PLATE[0], PLATE[1]].tolist(),
        "plate_back": housing[PLATE[2], PLATE[3]].tolist(),
    }


def _turned(profile_x_r_m: list[tuple[float, float]], rows: int) -> Grid:
    """A profile (x, radius) turned about the drill's axis; rows run from the front to the back."""
    x, radius = np.array(surfaces.smooth_path(profile_x_r_m, rows)).T
    path = [(value, AXIS_Z_M) for value in x.tolist()]
    return surfaces.tube_grid(path, radius.tolist(), columns=COLUMNS)


def _housing(housing: Grid, rng: np.random.Generator) -> ColorImage:
    """The housing's texture: rows from front to back, columns around the axis."""
    image = prints.moulded(rng, 520, 960, YELLOW, rough=0.12)
    image[:60] = BLACK
    image[-90:] = BLACK
    (x0, y0), (_, y1) = prints.panel(image, housing, BADGE, BLACK)
    prints.write(image, "18V", (x0 + 14, (y0 + y1) // 2 + 16), 1.6, PAPER, 3)
    (x0, y0), (x1, y1) = prints.panel(image, housing, PLATE, PAPER)
    prints.small_print(image, x0 + 8, y0 + 14, x1 - x0 - 16, 6, BLACK)
    for row in range(390, 430, 14):  # vents
        for left in range(20, 960, 120):
            cv2.rectangle(image, (left, row), (left + 60, row + 6), (20, 20, 20), -1)
    return image


def _knurled(rng: np.random.Generator) -> ColorImage:
    image = prints.moulded(rng, 200, 300, STEEL, rough=0.3)
    image[60:130, ::8] = (60, 61, 64)
    return image


def _pack(rng: np.random.Generator) -> ColorImage:
    image = prints.moulded(rng, 200, 400, BLACK, rough=0.5)
    cv2.rectangle(image, (40, 60), (360, 150), YELLOW, -1)
    prints.write(image, "LI-ION 2.0", (70, 120), 1.3, BLACK, 3)
    return image
