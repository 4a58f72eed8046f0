"""Find the edges that a colour image and its depth image have in common: the outlines of things."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32

from rpl_data.types import ColorImage, DepthImage

STEP_PX = 2
"""Edges are found at 1 / this of the resolution; a lag or shift worth mending is larger than that."""

SURROUNDINGS = 31
"""Side of the square that an edge's strength is compared with, in pixels of the small image."""

Edges = Float32[np.ndarray, "rows columns"]


@dataclass(frozen=True)
class FrameEdges:
    """Edges of one frame's colour and depth images, at 1 / `STEP_PX` of the resolution."""

    color: Edges
    depth: Edges


def edges_of(color: ColorImage, depth_m: DepthImage) -> FrameEdges:
    """Find the edges of a frame: gradients of colour, and the near side of steps in depth."""
    return FrameEdges(_color_edges(color), _depth_edges(depth_m))


def _color_edges(color: ColorImage) -> Edges:
    """Gradients relative to their surroundings, so that a sharp print does not outweigh an outline."""
    grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    small = cv2.resize(grey, None, fx=1 / STEP_PX, fy=1 / STEP_PX, interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(small.astype(np.float32), (0, 0), 1.0)
    gradient = np.hypot(cv2.Scharr(smooth, cv2.CV_32F, 1, 0), cv2.Scharr(smooth, cv2.CV_32F, 0, 1))
    strength = np.sqrt(gradient)
    return _without_mean(strength / (cv2.blur(strength, (SURROUNDINGS, SURROUNDINGS)) + 5))


def _depth_edges(depth_m: DepthImage, *, step: float = 0.03, hole_px: int = 12) -> Edges:
    """1 on the near side of a step in depth, where it was measured; holes count as far surface."""
    small = depth_m[::STEP_PX, ::STEP_PX]
    reach = np.ones((hole_px // STEP_PX * 2 + 1,) * 2, np.uint8)
    filled = np.where(small > 0, small, cv2.dilate(small, reach))
    farthest = cv2.dilate(filled, np.ones((3, 3), np.uint8))
    edges = ((small > 0) & (farthest > small * (1 + step))).astype(np.float32)
    return _without_mean(cv2.GaussianBlur(edges, (3, 3), 0))


def _without_mean(image: Edges) -> Edges:
    """Subtract the local mean, and fade towards the border, where a circular shift would wrap around."""
    flat = image - cv2.blur(image, (SURROUNDINGS, SURROUNDINGS))
    window = np.outer(np.hanning(image.shape[0]), np.hanning(image.shape[1])) ** 0.25
    return (flat * window).astype(np.float32)
