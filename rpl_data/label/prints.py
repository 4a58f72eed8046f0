"""What is printed on an object, as single frames see it: what a frame is compared with, and by.

A `Look` is the part of a frame's image around the object, blurred by several widths, so that a print a few
pixels off is still found. A `Print` is what a look keeps of the object's surface: points of it with their
brightness.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from rpl_data.geometry import Pixels, Points, Transform, invert, transform
from rpl_data.label.alone import ObjectAlone
from rpl_data.label.masks import MaskPatch
from rpl_data.label.occlusion import DepthPatch
from rpl_data.raycast import PixelTable
from rpl_data.types import GreyImage, Window

BLURS_PX = (4.0, 2.0, 1.0)
"""Standard deviations of the Gaussians that the image is blurred with, coarse to fine."""
BORDER_PX = 20
"""The look reaches this far beyond the object: a label may be off by as much as its blur shows."""
WITHIN_PX, TAKEN_WITHIN_PX = 2, 3
"""Prints are compared this far within the outline, and taken that far within: beyond it, the background
shines in, and the mesh is least exact."""
CELL_PX = 3
"""A print has at most one point per square of this edge: that of the steepest brightness."""
MOST_POINTS, FEWEST_POINTS = 500, 60
SAME_SURFACE_M = 0.006
"""A point lies on the surface that a frame sees where its depth is that of the label's mesh within this."""

Patch = Float32[np.ndarray, "rows columns"]


@dataclass(frozen=True)
class Look:
    """The part of a frame around an object.

    Attributes:
        corner: column and row of the image where the part begins.
        levels: brightness, and its slopes to the right and down, per blur.
        window, depth_m: depth of the label's mesh, in its window of the image.
        inner: pixels of that window where the object itself is seen, its outline left out.
    """

    corner: tuple[int, int]
    levels: tuple[tuple[Patch, Patch, Patch], ...]
    window: Window
    depth_m: DepthPatch
    inner: MaskPatch

    def sees(self, uv_px: Pixels, depth_m: Float64[np.ndarray, " n"]) -> Any:
        """Whether points of the object, given by pixel and depth, are seen in this frame."""
        from rpl_data.label.compiled_prints import seen_points

        top, left = self.window[0].start, self.window[1].start
        return seen_points(uv_px, depth_m, top, left, self.depth_m, self.inner, SAME_SURFACE_M)

    def at(self, patch: Patch, uv_px: Pixels) -> Float64[np.ndarray, " n"]:
        """Values of a level's patch at finite pixels of the image, between pixels too (bilinear)."""
        from rpl_data.label.compiled_prints import values_at

        values: Float64[np.ndarray, " n"] = values_at(patch, uv_px, self.corner)
        return values


@dataclass(frozen=True)
class Print:
    """Points of an object's surface with the brightness that one frame shows there.

    Attributes:
        points: in the object frame.
        brightness: per blur, of each point.
    """

    points: Points
    brightness: Float64[np.ndarray, "l n"]


def look_at(grey: GreyImage, alone: ObjectAlone, visible: MaskPatch) -> Look:
    """The look of a frame at an object.

    Args:
        visible: the object's pixels that nothing hides, in its window.
    """
    rows, columns = alone.window
    top, left = max(rows.start - BORDER_PX, 0), max(columns.start - BORDER_PX, 0)
    part = grey[top : rows.stop + BORDER_PX, left : columns.stop + BORDER_PX].astype(np.float32)
    return Look(
        (left, top),
        tuple(_level(part, blur_px) for blur_px in BLURS_PX),
        alone.window,
        alone.depth_m,
        _within(visible, WITHIN_PX),
    )


def print_of(camera: PixelTable, look: Look, visible: MaskPatch, camera_from_object: Transform) -> Print:
    """The print that a frame shows, at most `MOST_POINTS` points of it, where brightness is steepest."""
    row, column = np.nonzero(_within(visible, TAKEN_WITHIN_PX))
    uv_px = np.column_stack([column + look.window[1].start, row + look.window[0].start]).astype(float)
    _, right, down = look.levels[-1]
    steep = np.hypot(look.at(right, uv_px), look.at(down, uv_px))
    order = np.lexsort((-steep, column // CELL_PX, row // CELL_PX))
    cells = np.column_stack([row, column])[order] // CELL_PX
    chosen = order[np.unique(cells, axis=0, return_index=True)[1]]
    chosen = chosen[np.argsort(-steep[chosen], kind="stable")][:MOST_POINTS]
    row, column, uv_px = row[chosen], column[chosen], uv_px[chosen]
    depth_m = look.depth_m[row, column].astype(np.float64)[:, None]
    points = camera.directions[look.window][row, column].astype(np.float64) * depth_m
    brightness = np.array([look.at(level[0], uv_px) for level in look.levels])
    return Print(transform(invert(camera_from_object), points), brightness.reshape(len(BLURS_PX), -1))


def _level(part: Patch, blur_px: float) -> tuple[Patch, Patch, Patch]:
    grey: Any = cv2.GaussianBlur(part, (0, 0), blur_px)
    slopes: list[Any] = [cv2.Scharr(grey, cv2.CV_32F, *axis, scale=1 / 32) for axis in ((1, 0), (0, 1))]
    return grey, slopes[0], slopes[1]


def _within(mask: MaskPatch, distance_px: int) -> MaskPatch:
    size = 2 * distance_px + 1
    eroded = cv2.erode(mask.view(np.uint8), np.ones((size, size), np.uint8), borderValue=0)
    inner: MaskPatch = np.asarray(eroded) > 0
    return inner
