"""What hides an object: itself, other objects, anything the depth sensor saw in front of it.

Everything here works on patches of depth in metres along the optical axis, all of the same window.
A model's depth is FAR_M where it is not; a measured depth is 0 where there is none, and hides nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from rpl_data.geometry import Pixels, Points, Transform, depth_sigma_m, invert
from rpl_data.label.masks import MaskPatch, Window, cleaned
from rpl_data.raycast import RayScene

AROUND_M = 0.005
"""The surface this near to a keypoint stands for it: clicks and meshes are off by millimetres."""

DIRECTIONS = 40
"""Points of that surface that are looked at, a keypoint."""

ENTERED_M = 0.005
"""A ray may enter the mesh this far before a point of its surface and still see it."""

SEEN_SHARE = 0.05
"""A keypoint is seen when this share of the surface around it is: two faces of three may turn away."""

DepthPatch = Float32[np.ndarray, "h w"]

FAR_M = 1e3
"""Depth of "nothing there" where depths are compared; finite, so that it can be squared."""


@dataclass(frozen=True)
class Tolerances:
    """When one surface hides another.

    Attributes:
        depth_m, depth_sigmas: measured depth hides what lies behind it by more than the larger of
            the two; the second in standard deviations of the sensor.
        neighbourhood_px: half the window in which depths are compared; absorbs misalignment.
    """

    depth_m: float = 0.015
    depth_sigmas: float = 4.0
    neighbourhood_px: int = 2

    def depth_at_m(self, depth_m: Any) -> Any:
        """The difference that matters at a depth."""
        return np.maximum(np.float32(self.depth_m), np.float32(self.depth_sigmas) * depth_sigma_m(depth_m))


def hidden_pixels(
    model_m: DepthPatch, others_m: DepthPatch, measured_m: DepthPatch, tolerances: Tolerances
) -> MaskPatch:
    """Pixels where another object, or something measured, stands in front of the object.

    Measured depth is compared with the nearest part of the object nearby, so that the object's own
    edges, a pixel off, do not hide it; specks of wrong depth are dropped and gaps are filled.
    """
    size = 2 * tolerances.neighbourhood_px + 1
    nearest = cv2.erode(model_m, np.ones((size, size), np.uint8))
    blocked = (measured_m > 0) & (measured_m < nearest - tolerances.depth_at_m(nearest))
    if blocked.any():
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
    """Which keypoints nothing but the object itself hides.

    Keypoints lie on edges and corners, where depth jumps from pixel to pixel: one is seen when any
    pixel beside it sees as far as the keypoint.

    Args:
        uv_px: where they project, in the image and inside the window.
        z_m: their depth.
    """
    patch = _neighbours(uv_px, window, tolerances.neighbourhood_px, others_m.shape)
    others, measured = others_m[patch], measured_m[patch]
    measured[~(measured > 0).any(axis=1)] = FAR_M
    z = z_m[:, None]
    seen: Bool[np.ndarray, " n"] = (others >= z - ENTERED_M).any(axis=1)
    seen &= (measured >= z - tolerances.depth_at_m(z)).any(axis=1)
    return seen


@dataclass(frozen=True)
class KeypointSurface:
    """The surface of an object around each of its keypoints; object frame.

    Attributes:
        points, normals: some points of it, unit normals pointing out.
        keypoint: the keypoint that each stands for.
    """

    points: Points
    normals: Points
    keypoint: Int64[np.ndarray, " n"]

    @staticmethod
    def around(rays: RayScene, points_object: Float64[np.ndarray, "k 3"]) -> KeypointSurface:
        """Points of the mesh nearest to those of a small sphere about each keypoint with a position."""
        known = np.flatnonzero(np.isfinite(points_object).all(axis=1))
        spheres = points_object[known, None] + AROUND_M * _directions()
        closest = rays.closest(spheres.reshape(-1, 3))
        return KeypointSurface(closest.points, closest.normals, np.repeat(known, DIRECTIONS))

    def faces(
        self, rays: RayScene, camera_from_object: Transform, *, keypoints: int
    ) -> Bool[np.ndarray, " keypoints"]:
        """Which keypoints the object itself does not hide: enough of the surface about them is seen."""
        towards = self.points - invert(camera_from_object)[:3, 3]
        far_m = np.linalg.norm(towards, axis=1)
        eye = np.broadcast_to(invert(camera_from_object)[:3, 3], towards.shape)
        hit_m = rays.cast_t(np.hstack([eye, towards / far_m[:, None]]).astype(np.float32))
        seen = ((self.normals * towards).sum(axis=1) < 0) & (hit_m >= far_m - ENTERED_M)
        count = np.bincount(self.keypoint, seen, minlength=keypoints)
        return np.asarray(count >= SEEN_SHARE * DIRECTIONS)


def _directions() -> Points:
    """Unit vectors spread evenly over the sphere (a Fibonacci lattice)."""
    number = np.arange(DIRECTIONS) + 0.5
    z, turn = 1 - 2 * number / DIRECTIONS, number * np.pi * (1 + 5**0.5)
    across = np.sqrt(1 - z**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


def _neighbours(
    uv_px: Pixels, window: Window, radius_px: int, shape: tuple[int, ...]
) -> tuple[Int64[np.ndarray, "n m"], Int64[np.ndarray, "n m"]]:
    """Rows and columns, in the window, of the square around each position."""
    offsets = np.arange(-radius_px, radius_px + 1)
    rows, columns = (side.ravel() for side in np.meshgrid(offsets, offsets, indexing="ij"))
    centre = np.rint(uv_px).astype(np.int64)
    row = centre[:, 1:] - window[0].start + rows
    column = centre[:, :1] - window[1].start + columns
    return row.clip(0, shape[0] - 1), column.clip(0, shape[1] - 1)


def depth_agreement(
    model_m: DepthPatch, visible: MaskPatch, measured_m: DepthPatch, tolerances: Tolerances
) -> float:
    """Share of the visible, measured pixels whose depth agrees with the model; 1 when there are none."""
    compared = visible & (measured_m > 0) & (model_m < FAR_M)
    if not compared.any():
        return 1.0
    expected = model_m[compared]
    agrees = np.abs(measured_m[compared] - expected) <= tolerances.depth_at_m(expected)
    return float(agrees.mean())
