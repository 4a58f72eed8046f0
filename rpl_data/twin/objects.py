"""The objects of a twin: a textured surface with landmarks a person would click."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64

from rpl_data.twin import surfaces, textures
from rpl_data.twin.surfaces import Surface
from rpl_data.types import ColorImage, DataError, KeypointModel


@dataclass(frozen=True)
class TwinObject:
    """An object with exact truth; the object frame's origin is the centroid of the landmarks.

    Attributes:
        surface: triangles in the object frame.
        model: the landmarks, on corners and edges, in the object frame.
    """

    surface: Surface
    model: KeypointModel


def build(name: str) -> TwinObject:
    """The object of that name; DataError when there is none."""
    if name not in OBJECTS:
        raise DataError(f"there is no twin object {name!r}; expected one of {', '.join(OBJECTS)}")
    return OBJECTS[name]()


def _centred(
    name: str, surface: Surface, landmarks: Mapping[str, Sequence[float]], edges: Sequence[tuple[int, int]]
) -> TwinObject:
    """The object with its frame moved to the centroid of its landmarks."""
    points = np.array(list(landmarks.values()), dtype=float)
    centre = points.mean(axis=0)
    model = KeypointModel(name, tuple(landmarks), points - centre, tuple(edges))
    return TwinObject(replace(surface, vertices=surface.vertices - centre), model)


# The carton ---------------------------------------------------------------------------------------

CARTON_SIZE_M = (0.090, 0.060, 0.140)
PRINT_PX_PER_M = 4000
INK, PAPER, RED, GREEN, YELLOW = (38, 46, 84), (238, 234, 222), (196, 52, 46), (58, 128, 86), (240, 190, 60)


def carton() -> TwinObject:
    """A printed box, 90 x 60 x 140 mm; six different faces; landmarks are its eight corners."""
    x, y, z = CARTON_SIZE_M
    faces = [
        _carton_front(x, z),
        _carton_back(x, z),
        _carton_left(y, z),
        _carton_right(y, z),
        _carton_top(x, y),
        _carton_bottom(x, y),
    ]
    atlas, rects = textures.pack(faces)
    surface = surfaces.joined(surfaces.box(CARTON_SIZE_M, rects, cells=14), atlas, gloss=0.08)
    corners = {
        f"{height}_{depth}_{side}": (sx * x / 2, sy * y / 2, sz * z / 2)
        for height, sz in (("top", 1), ("bottom", -1))
        for depth, sy in (("front", -1), ("back", 1))
        for side, sx in (("left", -1), ("right", 1))
    }
    edges = [(0, 1), (1, 3), (3, 2), (2, 0), (4, 5), (5, 7), (7, 6), (6, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
    return _centred("carton", surface, corners, edges)


def _sheet(width_m: float, height_m: float, color: tuple[int, int, int]) -> ColorImage:
    """A blank face, with the darker line a fold has."""
    image = np.full((round(height_m * PRINT_PX_PER_M), round(width_m * PRINT_PX_PER_M), 3), color, np.uint8)
    worn = tuple(int(0.8 * channel) for channel in color)
    cv2.rectangle(image, (0, 0), (image.shape[1] - 1, image.shape[0] - 1), worn, 5)
    return image


def _write(
    image: ColorImage,
    text: str,
    at: tuple[int, int],
    size: float,
    color: tuple[int, int, int],
    thick: int = 2,
) -> None:
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_DUPLEX, size, color, thick, cv2.LINE_AA)


def _carton_front(x: float, z: float) -> ColorImage:
    image = _sheet(x, z, YELLOW)
    image[330:] = RED
    cv2.circle(image, (215, 190), 105, PAPER, -1, cv2.LINE_AA)
    leaf = np.array([[215, 100], [275, 180], [225, 275], [165, 200]])
    cv2.fillPoly(image, [leaf], GREEN, cv2.LINE_AA)
    cv2.line(image, (215, 100), (225, 275), PAPER, 5, cv2.LINE_AA)
    _write(image, "OOLONG", (24, 405), 2.4, PAPER, 6)
    _write(image, "mountain tea", (30, 460), 1.2, PAPER)
    _write(image, "50 bags  125 g", (30, 530), 1.0, YELLOW)
    cv2.rectangle(image, (22, 22), (120, 62), INK, -1)
    _write(image, "NEW", (36, 54), 1.0, PAPER)
    return image


def _carton_back(x: float, z: float) -> ColorImage:
    image = _sheet(x, z, PAPER)
    image[:90] = RED
    _write(image, "Brewing", (24, 62), 1.6, PAPER, 3)
    rng = np.random.default_rng(11)
    for line in range(12):
        cv2.line(image, (24, 125 + 20 * line), (int(rng.integers(200, 335)), 125 + 20 * line), INK, 4)
    cv2.rectangle(image, (30, 380), (190, 530), GREEN, -1)
    _write(image, "3 min", (45, 470), 1.2, PAPER)
    cv2.circle(image, (280, 455), 55, YELLOW, -1, cv2.LINE_AA)
    return image


def _carton_left(y: float, z: float) -> ColorImage:
    image = _sheet(y, z, RED)
    cv2.rectangle(image, (30, 40), (210, 260), PAPER, -1)
    _write(image, "Nutrition", (42, 75), 0.9, INK)
    for line in range(7):
        cv2.line(image, (42, 100 + 22 * line), (198, 100 + 22 * line), INK, 2)
        _write(image, "0 g" if line % 2 else "12 kJ", (140, 96 + 22 * line), 0.45, INK, 1)
    _barcode(image, 45, 400, 150, 110)
    return image


def _barcode(image: ColorImage, left: int, top: int, width: int, height: int) -> None:
    cv2.rectangle(image, (left - 10, top - 10), (left + width + 10, top + height + 10), PAPER, -1)
    rng, u = np.random.default_rng(7), left
    while u < left + width:
        bar = int(rng.integers(3, 9))
        image[top : top + height, u : u + bar // 2 + 2] = (20, 20, 20)
        u += bar + 3


def _carton_right(y: float, z: float) -> ColorImage:
    image = _sheet(y, z, GREEN)
    for row in range(6):
        for column in range(3):
            at = (50 + 70 * column, 60 + 88 * row)
            color = YELLOW if (row * 3 + column) % 4 else RED
            cv2.ellipse(image, at, (22, 34), 25 * row + 15 * column, 0, 360, color, -1, cv2.LINE_AA)
    return image


def _carton_top(x: float, y: float) -> ColorImage:
    image = _sheet(x, y, PAPER)
    cv2.fillPoly(image, [np.array([[0, 0], [150, 0], [60, 239], [0, 239]])], RED, cv2.LINE_AA)
    _write(image, "TEA", (165, 150), 2.2, INK, 5)
    return image


def _carton_bottom(x: float, y: float) -> ColorImage:
    image = _sheet(x, y, (186, 160, 124))
    _write(image, "LOT 04-27", (40, 80), 1.2, INK)
    cv2.circle(image, (270, 170), 40, INK, 4, cv2.LINE_AA)
    cv2.rectangle(image, (40, 130), (140, 200), GREEN, -1)
    return image


# The kettle ---------------------------------------------------------------------------------------

BODY_RZ_M = [
    (0.030, 0.108), (0.036, 0.1055), (0.040, 0.100), (0.043, 0.090), (0.0455, 0.078), (0.048, 0.066),
    (0.050, 0.054), (0.052, 0.040), (0.0535, 0.026), (0.0545, 0.014), (0.055, 0.005), (0.054, 0.001),
]  # fmt: skip
BODY_COLUMNS = 96
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
    """An enamelled kettle, 200 mm from handle to spout, curved body; landmarks on corners and marks."""
    body = surfaces.lathe_grid(BODY_RZ_M, columns=BODY_COLUMNS)
    spout = surfaces.tube_grid(SPOUT_XZ_M, SPOUT_RADII_M)
    rng = np.random.default_rng(3)
    atlas, (body_rect, metal_rect, dark_rect) = textures.pack(
        [_kettle_print(), _brushed(rng), np.full((64, 64, 3), 24, np.uint8)]
    )
    lid = surfaces.lathe_grid(
        [(0.0, 0.113), (0.012, 0.1125), (0.022, 0.1105), (0.030, 0.108)], columns=BODY_COLUMNS
    )
    bottom = surfaces.lathe_grid([(0.054, 0.001), (0.050, 0.0), (0.0, 0.0)], columns=BODY_COLUMNS)
    knob = [
        replace(face, vertices=face.vertices + KNOB_CENTRE_M)
        for face in surfaces.box(KNOB_SIZE_M, [dark_rect] * 6, cells=4)
    ]
    mouth = np.stack([np.broadcast_to(spout[0, :-1].mean(axis=0), spout[0].shape), spout[0]])
    parts = [
        surfaces.patch(body, body_rect),
        surfaces.patch(lid, metal_rect),
        surfaces.patch(bottom, metal_rect),
        surfaces.patch(spout, metal_rect),
        surfaces.patch(mouth, dark_rect),
        *knob,
        *_handle(metal_rect),
    ]
    surface = surfaces.joined(parts, atlas, gloss=0.35)
    return _centred(
        "kettle",
        surface,
        _kettle_landmarks(body, spout),
        [(0, 1), (2, 3), (4, 5), (2, 4), (3, 5), (6, 7), (8, 9)],
    )


def _kettle_landmarks(
    body: Float64[np.ndarray, "_ _ 3"], spout: Float64[np.ndarray, "_ _ 3"]
) -> dict[str, Sequence[float]]:
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
        "badge_corner": body[BADGE[0], BADGE[1]].tolist(),
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
    return [surfaces.quad(face, uv_rect, cells=4) for face in faces]


def _kettle_print() -> ColorImage:
    """The body's decoration, one turn wide, top to bottom: bands, flowers, a badge and a gauge."""
    rows, width, height = len(BODY_RZ_M) - 1, 1440, 500
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

    def corners(mark: tuple[int, int, int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
        top, left, bottom, right = mark
        x0, x1 = (round(column / BODY_COLUMNS * (width - 1)) for column in (left, right))
        y0, y1 = (round(row / rows * (height - 1)) for row in (top, bottom))
        return (x0, y0), (x1, y1)

    (x0, y0), (x1, y1) = corners(BADGE)
    cv2.rectangle(image, (x0, y0), (x1, y1), (236, 232, 220), -1)
    _write(image, "HEARTH", (x0 + 14, (y0 + y1) // 2), 1.5, (170, 40, 40), 4)
    _write(image, "1.2 litre", (x0 + 30, y1 - 30), 1.0, (40, 40, 60))
    (x0, y0), (x1, y1) = corners(GAUGE)
    cv2.rectangle(image, (x0, y0), (x1, y1), (240, 205, 70), -1)
    for v in range(y0 + 15, y1, 22):
        cv2.line(image, (x0, v), ((x0 + x1) // 2, v), (30, 30, 30), 4)
    return image


def _brushed(rng: np.random.Generator) -> ColorImage:
    """Worn enamel for handle, spout and lid."""
    noise = textures.fractal_noise(rng, 256, 256, cells=6)
    image = textures.blend(noise, (150, 60, 40), (186, 92, 62))
    image[(textures.fractal_noise(rng, 256, 256, cells=24, octaves=2) > 0.93)] = (70, 40, 34)
    return image


OBJECTS: dict[str, Callable[[], TwinObject]] = {"carton": carton, "kettle": kettle}
