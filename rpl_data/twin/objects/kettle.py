"""An enamelled kettle: a curved body with few corners."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from rpl_data.twin import prints, surfaces, textures
from rpl_data.twin.objects.model import TwinObject, assembled
from rpl_data.twin.surfaces import Grid, Surface
from rpl_data.types import ColorImage

BODY_RZ_M = [
    (0.030, 0.108), (0.036, 0.1055), (0.040, 0.100), (0.043, 0.090), (0.0455, 0.078), (0.048, 0.066),
    (0.050, 0.054), (0.052, 0.040), (0.0535, 0.026), (0.0545, 0.014), (0.055, 0.005), (0.054, 0.001),
]  # fmt: skip
BODY_COLUMNS = 96
GLOSS = 0.35
BADGE = (3, 18, 7, 33)
"""Rows and columns of the body's grid that the printed badge spans: top, left, bottom, right."""
GAUGE = (4, 62, 8, 66)
SPOUT_XZ_M = [(0.040, 0.040), (0.058, 0.052), (0.074, 0.072), (0.086, 0.092), (0.096, 0.108)]
SPOUT_RADII_M = [0.016, 0.0135, 0.0115, 0.010, 0.009]
HANDLE_OUTER_XZ_M = [(-0.032, 0.104), (-0.095, 0.106), (-0.090, 0.030), (-0.045, 0.030)]
HANDLE_INNER_XZ_M = [(-0.034, 0.091), (-0.081, 0.093), (-0.077, 0.043), (-0.045, 0.043)]
HANDLE_HALF_M = 0.010
KNOB_SIZE_M = (0.018, 0.026, 0.020)
KNOB_CENTRE_M = (0.003, 0.0, 0.121)


def kettle() -> TwinObject:
    """Build an enamelled kettle, 200 mm from handle to spout; its landmarks are corners and printed marks."""
    body = surfaces.lathe_grid(BODY_RZ_M, columns=BODY_COLUMNS)
    spout = surfaces.tube_grid(SPOUT_XZ_M, SPOUT_RADII_M)
    rng = np.random.default_rng(3)
    atlas, (body_rect, metal_rect, dark_rect) = textures.pack(
        [_enamel(body), _brushed(rng), np.full((64, 64, 3), 24, np.uint8)]
    )
    lid = surfaces.lathe_grid(
        [(0.0, 0.113), (0.012, 0.1125), (0.022, 0.1105), (0.030, 0.108)], columns=BODY_COLUMNS
    )
    bottom = surfaces.lathe_grid([(0.054, 0.001), (0.050, 0.0), (0.0, 0.0)], columns=BODY_COLUMNS)
    knob = surfaces.box(KNOB_SIZE_M, [dark_rect] * 6, centre_m=KNOB_CENTRE_M, cells=4, gloss=GLOSS)
    mouth = np.stack([np.broadcast_to(spout[0, :-1].mean(axis=0), spout[0].shape), spout[0]])
    parts = [
        surfaces.patch(body, body_rect, gloss=GLOSS),
        surfaces.patch(lid, metal_rect, gloss=GLOSS),
        surfaces.patch(bottom, metal_rect, gloss=GLOSS),
        surfaces.patch(spout, metal_rect, gloss=GLOSS),
        surfaces.patch(mouth, dark_rect, gloss=GLOSS),
        *knob,
        *_handle(metal_rect),
    ]
    surface = surfaces.joined(parts, atlas)
    lines = [
        ("spout_upper_lip", "spout_lower_lip"),
        ("handle_top_left", "handle_top_right"),
        ("handle_bottom_left", "handle_bottom_right"),
        ("handle_top_left", "handle_bottom_left"),
        ("handle_top_right", "handle_bottom_right"),
        ("knob_left", "knob_right"),
        ("badge_top_corner", "badge_bottom_corner"),
    ]
    return assembled("kettle", surface, _landmarks(body, spout), lines)


def _landmarks(body: Grid, spout: Grid) -> dict[str, Sequence[float]]:
    (top_x, top_z), (low_x, low_z) = HANDLE_OUTER_XZ_M[1], HANDLE_OUTER_XZ_M[2]
    (cx, cy, cz), (kx, ky, kz) = KNOB_CENTRE_M, KNOB_SIZE_M
    tip = spout[0]
    return {
        "spout_upper_lip": tip[np.argmax(tip[:, 2])].tolist(),
        "spout_lower_lip": tip[np.argmin(tip[:, 2])].tolist(),
        "handle_top_left": (top_x, HANDLE_HALF_M, top_z),
        "handle_top_right": (top_x, -HANDLE_HALF_M, top_z),
        "handle_bottom_left": (low_x, HANDLE_HALF_M, low_z),
        "handle_bottom_right": (low_x, -HANDLE_HALF_M, low_z),
        "knob_left": (cx + kx / 2, cy + ky / 2, cz + kz / 2),
        "knob_right": (cx - kx / 2, cy - ky / 2, cz + kz / 2),
        "badge_top_corner": body[BADGE[0], BADGE[1]].tolist(),
        "badge_bottom_corner": body[BADGE[2], BADGE[3]].tolist(),
        "gauge_corner": body[GAUGE[2], GAUGE[3]].tolist(),
    }


def _handle(uv_rect: surfaces.UvRect) -> list[Surface]:
    """A flat bar bent twice, with sharp mitred corners; its ends are inside the body."""
    h, faces = HANDLE_HALF_M, []
    outer, inner = HANDLE_OUTER_XZ_M, HANDLE_INNER_XZ_M
    for (ax, az), (bx, bz), (cx, cz), (dx, dz) in zip(outer, outer[1:], inner, inner[1:], strict=False):
        # a to b along the outside, c to d along the inside; left is +y
        faces.append([(bx, h, bz), (bx, -h, bz), (ax, h, az), (ax, -h, az)])
        faces.append([(dx, -h, dz), (dx, h, dz), (cx, -h, cz), (cx, h, cz)])
        faces.append([(ax, h, az), (cx, h, cz), (bx, h, bz), (dx, h, dz)])
        faces.append([(cx, -h, cz), (ax, -h, az), (dx, -h, dz), (bx, -h, bz)])
    return [surfaces.quad(face, uv_rect, cells=4, gloss=GLOSS) for face in faces]


def _enamel(body: Grid) -> ColorImage:
    """The body's texture, once around, from top to bottom: bands, flowers, a badge and a gauge."""
    width, height = 1440, 500
    image = np.full((height, width, 3), (64, 112, 150), np.uint8)
    image[:70], image[-80:] = (226, 220, 204), (226, 220, 204)
    rng = np.random.default_rng(5)
    for u in range(30, width, 75):
        at = (u, int(rng.integers(110, 380)))
        for petal in range(5):
            angle = 2 * np.pi * petal / 5 + u
            cv2.circle(
                image,
                (int(at[0] + 12 * np.cos(angle)), int(at[1] + 12 * np.sin(angle))),
                9,
                (232, 214, 190),
                -1,
                cv2.LINE_AA,
            )
        cv2.circle(image, at, 7, (214, 120, 60), -1, cv2.LINE_AA)

    (x0, y0), (_, y1) = prints.panel(image, body, BADGE, (236, 232, 220))
    prints.write(image, "HEARTH", (x0 + 14, (y0 + y1) // 2), 1.5, (170, 40, 40), 4)
    prints.write(image, "1.2 litre", (x0 + 30, y1 - 30), 1.0, (40, 40, 60))
    (x0, y0), (x1, y1) = prints.panel(image, body, GAUGE, (240, 205, 70))
    for v in range(y0 + 15, y1, 22):
        cv2.line(image, (x0, v), ((x0 + x1) // 2, v), (30, 30, 30), 4)
    return image


def _brushed(rng: np.random.Generator) -> ColorImage:
    """Worn enamel for handle, spout and lid."""
    noise = textures.fractal_noise(rng, 256, 256, cells=6)
    image = textures.blend(noise, (150, 60, 40), (186, 92, 62))
    image[(textures.fractal_noise(rng, 256, 256, cells=24, octaves=2) > 0.93)] = (70, 40, 34)
    return image
