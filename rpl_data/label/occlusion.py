"""Occlusion: what hides an object - itself, other objects, or anything that the sensor measured before it.

All functions take patches of depth, in metres along the optical axis, of the same window of the image. The
depth of a model is FAR_M where the model is not. Measured depth is 0 where it is missing, and then hides
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from rpl_data.geometry import Pixels, depth_sigma_m
from rpl_data.keypoint_surface import ENTERED_M
from rpl_data.label.masks import MaskPatch, cleaned
from rpl_data.types import Window

DepthPatch = Float32[np.ndarray, "h w"]
Depths = Float[np.ndarray, "*shape"]

FAR_M = 1e3
"""Depth of "nothing there" where depths are compared; finite, so that it can be squared."""


@dataclass(frozen=True)
class Tolerances:
    """By how much depths must differ for one surface to hide another.

    Attributes:
        depth_m, depth_sigmas: measured depth hides what lies farther behind it than the larger of the
            two; the second is in standard deviations of the sensor.
        neighbourhood_px: half the size of the neighbourhood in which depths are compared, which absorbs
            misalignment.
    """

    depth_m: float = 0.015
    depth_sigmas: float = 4.0
    neighbourhood_px: int = 2

    def depth_at_m(self, depth_m: Depths) -> Depths:
        """The smallest difference in depth that hides, at each depth."""
        found: Depths = np.maximum(
            np.float32(self.depth_m), np.float32(self.depth_sigmas) * depth_sigma_m(depth_m)
        )
        return found


def hidden_pixels(
    model_m: DepthPatch, others_m: DepthPatch, measured_m: DepthPatch, tolerances: Tolerances
) -> MaskPatch:
    """Find the pixels where another object, or measured depth, lies in front of the object.

    Measured depth is compared with the nearest depth of the object in the neighbourhood, so that the object
    does not hide itself where its edges are a pixel off. Specks of wrong depth are dropped, gaps are filled.

    Raises:
        ValueError: the patches have different shapes, as where a depth image is not of the camera's size.
    """
    from rpl_data.label.compiled_occlusion import mark_blocked

    if not model_m.shape == others_m.shape == measured_m.shape:  # compiled code would read past the end
        raise ValueError(
            f"depth of an object, of others and of the sensor in one window have the shapes {model_m.shape}, "
            f"{others_m.shape} and {measured_m.shape}; depth images must be of the camera's size"
        )
    size = 2 * tolerances.neighbourhood_px + 1
    nearest = cv2.erode(model_m, np.ones((size, size), np.uint8))
    blocked: MaskPatch = np.empty(model_m.shape, np.bool_)
    if mark_blocked(nearest, measured_m, tolerances.depth_m, tolerances.depth_sigmas, blocked):
        blocked = cleaned(cleaned(blocked, "open", size_px=3), "close", size_px=5)
    hidden: MaskPatch = blocked | (others_m < model_m)
    return hidden


def keypoints_seen(
    uv_px: Pixels,
    z_m: Float64[np.ndarray, " n"],
    window: Window,
    others_m: DepthPatch,
    measured_m: DepthPatch,
    tolerances: Tolerances,
) -> Bool[np.ndarray, " n"]:
    """Find the keypoints that nothing else hides; whether the object hides them itself is not tested here.

    Keypoints lie on edges and corners, where depth jumps from pixel to pixel. So a keypoint is seen when any
    pixel of its neighbourhood is at least as far as the keypoint.

    Args:
        uv_px: projections of the keypoints, in pixels of the image, inside the window.
        z_m: depths of the keypoints.
    """
    from rpl_data.label.compiled_occlusion import mark_seen

    corner = [window[0].start, window[1].start]
    centres = np.rint(uv_px[:, ::-1]).astype(np.int64) - corner
    seen: Bool[np.ndarray, " n"] = np.empty(len(uv_px), np.bool_)
    behind_m = z_m - tolerances.depth_at_m(z_m)
    mark_seen(centres, z_m - ENTERED_M, behind_m, tolerances.neighbourhood_px, others_m, measured_m, seen)
    return seen


def depth_disagreement(
    model_m: DepthPatch, visible: MaskPatch, measured_m: DepthPatch, tolerances: Tolerances
) -> float:
    """Share of the visible pixels whose measured depth is not the model's; 0 when there are none.

    Pixels without depth are not counted, unless the object is why they have none, being dark or shiny. Those
    agree, since the few pixels of it that have depth are its edges. They are as many as the object has more
    pixels without depth than its surroundings let expect: a wrong pose over a hole does not pass for right.
    """
    from rpl_data.label.compiled_occlusion import count_pixels

    shown, measured, disagreeing, beside, measured_beside = count_pixels(
        model_m, visible, measured_m, FAR_M, tolerances.depth_m, tolerances.depth_sigmas
    )
    if not measured:
        return 0.0
    # A pixel of the object has a depth where neither the surroundings nor the object prevent it.
    usual = shown * (measured_beside / beside if beside else 1.0)
    by_object = shown * max(1 - measured / usual, 0.0) if usual else 0.0
    return float(disagreeing / (measured + by_object))
