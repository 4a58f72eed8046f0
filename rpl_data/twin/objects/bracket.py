"""A blackened steel bracket: dark and shiny, so the depth camera misses much of it."""

from __future__ import annotations

import numpy as np

from rpl_data.twin import prints, surfaces, textures
from rpl_data.twin.objects.model import TwinObject, assembled
from rpl_data.twin.prints import INK, PAPER
from rpl_data.twin.surfaces import Surface, UvRect
from rpl_data.types import ColorImage

STEEL = (34, 35, 38)
GLOSS = 0.9
THICK_M = 0.009
BASE_SIZE_M, WALL_SIZE_M = (0.120, 0.080, THICK_M), (THICK_M, 0.080, 0.076)
BASE_CENTRE_M = (0.0, 0.0, THICK_M / 2)
WALL_CENTRE_M = (-(0.120 - THICK_M) / 2, 0.0, THICK_M + 0.038)
RIB_TOE_X_M, RIB_TOP_M, RIB_HALF_M = -0.006, 0.062, 0.004
BOSS_M = (0.022, 0.0)
STICKER_M = (0.030, 0.012, 0.052, 0.034)
"""x0, y0, x1, y1 of the sticker on the base plate."""


def bracket() -> TwinObject:
    """Build an angle bracket with ribs and a boss, 120 x 80 x 85 mm; landmarks on it and a sticker."""
    rng = np.random.default_rng(51)
    atlas, (steel, bore, paper) = textures.pack([_steel(rng), np.full((32, 32, 3), 14, np.uint8), _sticker()])
    parts = [
        *surfaces.box(BASE_SIZE_M, [steel] * 6, centre_m=BASE_CENTRE_M, cells=8, gloss=GLOSS),
        *surfaces.box(WALL_SIZE_M, [steel] * 6, centre_m=WALL_CENTRE_M, cells=8, gloss=GLOSS),
        *_rib(0.032, steel),
        *_rib(-0.032, steel),
        *_boss(steel, bore),
        _label(paper),
    ]
    lines = [
        ("base_front_left", "base_front_right"),
        ("wall_top_left", "wall_top_right"),
        ("wall_top_left", "base_back_left"),
        ("wall_top_right", "base_back_right"),
    ]
    return assembled("bracket", surfaces.joined(parts, atlas), _landmarks(), lines)


def _landmarks() -> dict[str, list[float]]:
    x, y = BASE_SIZE_M[0] / 2, BASE_SIZE_M[1] / 2
    top = THICK_M + WALL_SIZE_M[2]
    x0, y0, x1, y1 = STICKER_M
    sticker_z = THICK_M + 2e-4
    return {
        "base_front_left": [x, y, THICK_M],
        "base_front_right": [x, -y, THICK_M],
        "wall_top_left": [-x, y, top],
        "wall_top_right": [-x, -y, top],
        "base_back_left": [-x, y, 0.0],
        "base_back_right": [-x, -y, 0.0],
        "base_front_left_low": [x, y, 0.0],
        "rib_toe_left": [RIB_TOE_X_M, 0.032 + RIB_HALF_M, THICK_M],
        "rib_toe_right": [RIB_TOE_X_M, -0.032 - RIB_HALF_M, THICK_M],
        "sticker_near": [x1, y0, sticker_z],
        "sticker_far": [x0, y1, sticker_z],
    }


def _rib(y: float, rect: UvRect) -> list[Surface]:
    """A triangular web between base and wall."""
    back, low, h = -(BASE_SIZE_M[0] / 2 - THICK_M), THICK_M, RIB_HALF_M
    (left, right), (top_left, top_right), (toe_left, toe_right) = (
        ((x, y + h, z), (x, y - h, z)) for x, z in ((back, low), (back, RIB_TOP_M), (RIB_TOE_X_M, low))
    )
    faces = [
        [top_left, top_left, toe_left, left],
        [top_right, top_right, right, toe_right],
        [top_right, top_left, toe_right, toe_left],
    ]
    return [surfaces.quad(face, rect, cells=6, gloss=GLOSS) for face in faces]


def _boss(steel: UvRect, bore: UvRect) -> list[Surface]:
    """A round boss with a blind hole."""
    profiles = [
        ([(0.0, 0.014), (0.009, 0.014)], bore),
        ([(0.009, 0.014), (0.009, 0.034)], bore),
        ([(0.009, 0.034), (0.017, 0.034)], steel),
        ([(0.017, 0.034), (0.018, 0.033), (0.019, THICK_M)], steel),
    ]
    grids = [(surfaces.lathe_grid(profile), rect) for profile, rect in profiles]
    offset = np.array([*BOSS_M, 0.0])
    return [surfaces.patch(grid + offset, rect, gloss=GLOSS) for grid, rect in grids]


def _label(rect: UvRect) -> Surface:
    x0, y0, x1, y1 = STICKER_M
    z = THICK_M + 2e-4
    return surfaces.quad([(x0, y1, z), (x1, y1, z), (x0, y0, z), (x1, y0, z)], rect, cells=2)


def _steel(rng: np.random.Generator) -> ColorImage:
    """Blackened, machined steel: fine parallel scratches."""
    image = prints.moulded(rng, 400, 400, STEEL, rough=0.5).astype(np.float32)
    scratches = 1 + 0.25 * (rng.random((400, 1), dtype=np.float32) - 0.5)
    return (image * scratches[..., None]).clip(0, 255).astype(np.uint8)


def _sticker() -> ColorImage:
    image = np.full((176, 176, 3), PAPER, np.uint8)
    prints.write(image, "QC 12", (16, 60), 1.4, INK, 3)
    prints.barcode(image, 24, 90, 120, 60)
    return image
