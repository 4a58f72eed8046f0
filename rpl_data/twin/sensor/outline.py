"""Outlines, where one surface ends in front of another: distance to the nearest, and the depth across it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from rpl_data.types import DepthImage


@dataclass(frozen=True)
class Outlines:
    """The outline next to every pixel; distances are inf where there is none.

    Attributes:
        nearer_px: distance to the nearest pixel of a surface that ends in front of this one, 1 = adjacent.
        nearer_m: depth of that pixel.
        farther_px, farther_m: the same for the surface behind, for pixels of the one in front.
    """

    nearer_px: Float32[np.ndarray, "height width"]
    nearer_m: DepthImage
    farther_px: Float32[np.ndarray, "height width"]
    farther_m: DepthImage


def find_outlines(
    depth_m: DepthImage,
    cos_incidence: Float32[np.ndarray, "height width"],
    *,
    step_m: float,
    focal_px: float,
) -> Outlines:
    """Find steps of depth between neighbours that are larger than the slope of the surfaces explains."""
    slant = np.sqrt(1 / np.square(cos_incidence.clip(0.2, 1)) - 1)  # at a contour the slope is meaningless
    allowed_m = np.float32(step_m) + np.float32(1.5 / focal_px) * depth_m * slant
    before, behind = _sides(depth_m, allowed_m)
    nearer_px, nearer_m = _nearest(before, depth_m)
    farther_px, farther_m = _nearest(behind, depth_m)
    inf = np.float32(np.inf)
    return Outlines(
        np.where(depth_m - nearer_m > step_m, nearer_px, inf),
        nearer_m,
        np.where(farther_m - depth_m > step_m, farther_px, inf),
        farther_m,
    )


def _sides(
    depth_m: DepthImage, allowed_m: Float32[np.ndarray, "height width"]
) -> tuple[Bool[np.ndarray, "height width"], Bool[np.ndarray, "height width"]]:
    """Pixels just in front of an outline, and pixels just behind one."""
    before, behind = np.zeros(depth_m.shape, bool), np.zeros(depth_m.shape, bool)
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        step_m = depth_m[other] - depth_m[one]
        allowed = np.minimum(allowed_m[one], allowed_m[other])
        measured = (depth_m[one] > 0) & (depth_m[other] > 0)
        rises, falls = measured & (step_m > allowed), measured & (-step_m > allowed)
        before[one] |= rises
        behind[other] |= rises
        before[other] |= falls
        behind[one] |= falls
    return before, behind


def _nearest(
    marked: Bool[np.ndarray, "height width"], depth_m: DepthImage
) -> tuple[Float32[np.ndarray, "height width"], DepthImage]:
    """Distance to the nearest marked pixel and the depth there; inf and the pixel's own depth if none."""
    if not marked.any():
        return np.full(depth_m.shape, np.inf, np.float32), depth_m
    distance, label = cv2.distanceTransformWithLabels(
        (~marked).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(int(label.max()) + 1, np.float32)
    of_label[label[marked]] = depth_m[marked]
    return np.asarray(distance, np.float32), of_label[label]
