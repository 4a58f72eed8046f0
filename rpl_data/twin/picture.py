"""Textures with smaller copies of themselves, so that distant surfaces do not flicker."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Int32, UInt8

from rpl_data.twin.surfaces import Surface
from rpl_data.types import ColorImage

LEVELS = 6


@dataclass(frozen=True)
class Picture:
    """A texture and its repeated halvings in one image (Williams, "Pyramidal parametrics", 1983).

    Attributes:
        image: the texture, with its halvings in a column to its right; sRGB.
        left, top, width, height: position and size of each level in the image, pixels.
        texels_per_m: texture pixels (texels) per metre on every triangle, at full size.
    """

    image: ColorImage
    left: Int32[np.ndarray, " levels"]
    top: Int32[np.ndarray, " levels"]
    width: Int32[np.ndarray, " levels"]
    height: Int32[np.ndarray, " levels"]
    texels_per_m: Float32[np.ndarray, " m"]

    @staticmethod
    def of(surface: Surface) -> Picture:
        """Build the pyramid of a surface's texture."""
        pages = [surface.texture]
        while len(pages) < LEVELS and min(pages[-1].shape[:2]) > 1:
            height, width = (max(side // 2, 1) for side in pages[-1].shape[:2])
            pages.append(
                cv2.resize(pages[-1], (width, height), interpolation=cv2.INTER_AREA).astype(np.uint8)
            )
        heights, widths = (np.array([page.shape[axis] for page in pages], np.int32) for axis in (0, 1))
        right = int(widths[1]) if len(pages) > 1 else 0
        image = np.zeros((max(heights[0], heights[1:].sum()), widths[0] + right, 3), np.uint8)
        left = np.where(np.arange(len(pages)) > 0, widths[0], 0).astype(np.int32)
        top = np.concatenate([[0, 0], np.cumsum(heights[1:-1])])[: len(pages)].astype(np.int32)
        for page, x, y in zip(pages, left, top, strict=True):
            image[y : y + page.shape[0], x : x + page.shape[1]] = page
        return Picture(image, left, top, widths, heights, _texels_per_m(surface))

    def at(
        self, uv: Float32[np.ndarray, "n 2"], footprint_texels: Float32[np.ndarray, " n"]
    ) -> UInt8[np.ndarray, "n 3"]:
        """Colours at these positions (0 to 1, v down), each from the level whose texels match its pixel."""
        level = np.log2(np.maximum(footprint_texels, 1)).astype(np.int32).clip(0, len(self.left) - 1)
        width, height = self.width[level], self.height[level]
        x = (uv[:, 0] * width - 0.5).clip(0, width - 1) + self.left[level]
        y = (uv[:, 1] * height - 0.5).clip(0, height - 1) + self.top[level]
        return _remapped(self.image, x.astype(np.float32), y.astype(np.float32))


def _texels_per_m(surface: Surface) -> Float32[np.ndarray, " m"]:
    """Square root of the texture's area over the triangle's area."""
    a, b, c = (surface.vertices[surface.triangles[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    size = np.array(surface.texture.shape[1::-1], np.float64)
    edges = np.diff(surface.corner_uv * size, axis=1)
    texels = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    density: Float32[np.ndarray, " m"] = np.sqrt(texels / np.maximum(area, 1e-12)).astype(np.float32)
    return density


def _remapped(
    image: ColorImage, x: Float32[np.ndarray, " n"], y: Float32[np.ndarray, " n"]
) -> UInt8[np.ndarray, "n 3"]:
    """Sample the image at these positions, bilinearly."""
    rows = -(-len(x) // 1024)  # cv2.remap needs an image with no side over 32,767
    x_image, y_image = (np.resize(axis, (rows, 1024)) for axis in (x, y))
    picked = cv2.remap(image, x_image, y_image, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    colors: UInt8[np.ndarray, "n 3"] = picked.reshape(-1, 3)[: len(x)].astype(np.uint8, copy=False)
    return colors
