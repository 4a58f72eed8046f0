"""Procedural textures for tables, clutter and prints; each follows from its random generator."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from rpl_data.twin.surfaces import UvRect
from rpl_data.types import ColorImage

Rgb = tuple[int, int, int]
AnyImage = UInt8[np.ndarray, "_ _ 3"]
"""An image whose size differs from that of a `ColorImage` in the same signature."""


def fractal_noise(
    rng: np.random.Generator, height: int, width: int, *, cells: int = 4, octaves: int = 6
) -> Float32[np.ndarray, "height width"]:
    """Smooth noise, 0 to 1, with detail at every scale from the whole picture / `cells` downwards."""
    total = np.zeros((height, width), np.float32)
    for octave in range(octaves):
        size = min(cells << octave, height, width)
        grid = rng.random((size, size), dtype=np.float32)
        total += cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC) / np.float32(2**octave)
    low, high = np.percentile(total[::4, ::4], [0.5, 99.5])
    noise: Float32[np.ndarray, "height width"] = np.clip((total - low) / (high - low), 0, 1).astype(
        np.float32
    )
    return noise


def blend(amount: Float32[np.ndarray, "height width"], dark: Rgb, light: Rgb) -> ColorImage:
    """Mix from `dark` where amount = 0 to `light` where it is 1."""
    low, high = np.array(dark, np.float32), np.array(light, np.float32)
    image: ColorImage = (low + amount[..., None] * (high - low)).clip(0, 255).astype(np.uint8)
    return image


def wood(rng: np.random.Generator, size: int = 1024) -> ColorImage:
    """Boards with fibres along the columns and dark rings of late wood, each cut from another log."""
    bend = fractal_noise(rng, size, size, cells=2, octaves=3)
    strands = rng.random((size, size // 32), dtype=np.float32)
    shade = rng.uniform(0.82, 1.08, 8).astype(np.float32)
    board = np.arange(size) * 8 // size
    bend = np.where(board[:, None] % 2 == 0, bend, bend[::-1, ::-1])
    across = np.arange(size, dtype=np.float32)[:, None] / size
    ring = (22 * across + 3.5 * bend + 50 * shade[board, None]) % 1
    late = np.exp(-np.square(np.minimum(12 * ring, 3.5 * (1 - ring))))  # fades in slowly, ends abruptly
    fibre = cv2.resize(strands, (size, size), interpolation=cv2.INTER_LINEAR)
    tone = blend((0.35 + 0.55 * fibre - 0.33 * late).astype(np.float32), (112, 74, 44), (190, 143, 96))
    tone = (tone * shade[board, None, None]).clip(0, 255).astype(np.uint8)
    tone[:: size // 8] = (60, 40, 25)
    return tone


def cloth(rng: np.random.Generator, size: int = 1024) -> ColorImage:
    """A checked tablecloth."""
    first, second = _two_colors(rng)
    stripe = ((np.arange(size) // (size // 24)) % 3 == 0).astype(np.float32)
    amount = 0.5 * stripe[:, None] + 0.5 * stripe[None]
    weave = 0.1 * rng.random((size, size), dtype=np.float32)
    return blend(
        (0.85 * amount + weave).astype(np.float32), (226, 222, 210), first if rng.random() < 0.5 else second
    )


def stone(rng: np.random.Generator, size: int = 1024) -> ColorImage:
    """Speckled stone with veins."""
    clouds = fractal_noise(rng, size, size, cells=5)
    veins = np.abs(fractal_noise(rng, size, size, cells=3) - 0.5) < 0.012
    speckle = fractal_noise(rng, size, size, cells=256, octaves=2)
    tone = blend((0.6 * clouds + 0.4 * speckle).astype(np.float32), (92, 96, 104), (205, 203, 198))
    tone[veins] = (70, 66, 64)
    return cv2.GaussianBlur(tone, (0, 0), 0.8)


def newsprint(rng: np.random.Generator, size: int = 1024) -> ColorImage:
    """Columns of text and grey pictures, like newspaper laid out under the work."""
    page = np.full((size, size, 3), (214, 210, 198), np.uint8)
    for left in range(16, size - 100, 168):
        top = 16
        while top < size - 40:
            if rng.random() < 0.12:
                height = min(int(rng.integers(60, 140)), size - top)
                picture = fractal_noise(rng, height, 150, cells=3)
                page[top : top + height, left : left + 150] = blend(picture, (40, 40, 45), (225, 222, 215))
                top += height + 12
            elif rng.random() < 0.08:
                cv2.putText(
                    page,
                    _word(rng, 6).upper(),
                    (left, top + 24),
                    cv2.FONT_HERSHEY_DUPLEX,
                    0.9,
                    (30, 30, 30),
                    2,
                    cv2.LINE_AA,
                )
                top += 40
            else:
                cv2.putText(
                    page,
                    _word(rng, 20),
                    (left, top + 9),
                    cv2.FONT_HERSHEY_SIMPLEX,
                    0.38,
                    (60, 58, 56),
                    1,
                    cv2.LINE_AA,
                )
                top += 14
    return page[:, :size]


def plaster(rng: np.random.Generator, size: int = 512) -> ColorImage:
    """A painted wall or floor covering: hardly any texture."""
    base = np.array(rng.uniform((110, 115, 115), (200, 195, 190)))
    tone = 0.9 + 0.2 * fractal_noise(rng, size, size, cells=4, octaves=7)
    return (base * tone[..., None]).clip(0, 255).astype(np.uint8)


def even(rng: np.random.Generator, size: int = 64) -> ColorImage:
    """Paint of one colour, without any texture."""
    color = rng.uniform((110, 115, 115), (200, 195, 190)).astype(np.uint8)
    return np.broadcast_to(color, (size, size, 3)).copy()


def tiles(rng: np.random.Generator, size: int = 1024) -> ColorImage:
    """A tiled floor."""
    first, second = _two_colors(rng)
    cell = size // 16
    parity = (np.add.outer(np.arange(size) // cell, np.arange(size) // cell) % 2).astype(np.float32)
    tone = blend(
        (0.25 + 0.3 * parity + 0.2 * fractal_noise(rng, size, size)).astype(np.float32),
        (70, 66, 62),
        (215, 210, 200),
    )
    tone[::cell] = tone[:, ::cell] = first if rng.random() < 0.3 else (90, 88, 84)
    return tone


def print_of(rng: np.random.Generator, height: int, width: int) -> ColorImage:
    """A random print for clutter: a ground colour, blocks, stripes and words."""
    first, second = _two_colors(rng)
    lighter = (min(first[0] + 35, 255), min(first[1] + 35, 255), min(first[2] + 35, 255))
    image = blend(fractal_noise(rng, height, width, cells=2, octaves=3), first, lighter)
    for _ in range(3):
        x, y = int(rng.integers(0, width)), int(rng.integers(0, height))
        cv2.rectangle(image, (x, y), (x + width // 3, y + height // 8), second, -1)
    cv2.circle(image, (width // 2, height // 3), min(height, width) // 5, (235, 230, 215), -1, cv2.LINE_AA)
    for line in range(4):
        position = (width // 10, int(height * (0.6 + 0.1 * line)))
        cv2.putText(
            image,
            _word(rng, 9),
            position,
            cv2.FONT_HERSHEY_DUPLEX,
            width / 260,
            (245, 240, 230),
            1,
            cv2.LINE_AA,
        )
    return image


SUPPORTS: dict[str, Callable[[np.random.Generator], ColorImage]] = {
    "wood": wood,
    "cloth": cloth,
    "stone": stone,
    "newsprint": newsprint,
}


def pack(images: Sequence[AnyImage]) -> tuple[AnyImage, list[UvRect]]:
    """Pack images side by side into one texture; also the part each takes (half a pixel inside its edge)."""
    height = max(image.shape[0] for image in images)
    width = sum(image.shape[1] for image in images)
    atlas = np.zeros((height, width, 3), np.uint8)
    rects: list[UvRect] = []
    left = 0
    for image in images:
        h, w = image.shape[:2]
        atlas[:h, left : left + w] = image
        rects.append(((left + 0.5) / width, 0.5 / height, (left + w - 0.5) / width, (h - 0.5) / height))
        left += w
    return atlas, rects


def _two_colors(rng: np.random.Generator) -> tuple[Rgb, Rgb]:
    """Two saturated colours, far apart on the colour wheel."""
    hue = int(rng.integers(0, 180))
    hsv = np.array([[[hue, 170, 150], [(hue + 80) % 180, 150, 190]]], np.uint8)
    rgb = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0]
    return (int(rgb[0, 0]), int(rgb[0, 1]), int(rgb[0, 2])), (int(rgb[1, 0]), int(rgb[1, 1]), int(rgb[1, 2]))


def _word(rng: np.random.Generator, letters: int) -> str:
    alphabet = "abcdefghiklmnoprstuvw  "
    return "".join(alphabet[i] for i in rng.integers(0, len(alphabet), letters))
