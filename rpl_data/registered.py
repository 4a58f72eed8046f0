"""Depth of another size, or from another place, than colour: looked up at the pixels of the colour image.

A phone's depth has 256 x 192 pixels for a colour image of 1920 x 1440, seen through the same lens; the depth
camera of an Azure Kinect stands 32 mm beside its colour camera. Between depth pixels, 1/z is interpolated:
it is linear in the pixel on a plane, so planes stay planes at any ratio of the sizes. Where the four depth
pixels around do not lie on one surface, the nearest of them counts. No depth there instead would cost 1 % of
the masks' IoU on the twin, with 256 x 192 px of depth for 960 x 720 of colour.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int16, UInt8

from rpl_data.geometry import Transform, invert, project, rays, resized
from rpl_data.types import DepthImage, Intrinsics

MAX_SLOPE = 6.0
"""Tangent of the steepest angle (81 degrees) at which a surface is measured; what is steeper is an edge."""

PASSES = 3
"""Corrections of the depth at a colour pixel where two lenses lie apart; each shrinks the error tenfold."""

COARSE = 0.7
"""Focal length, of the depth camera's, of the image that depth is splatted into: it then leaves no holes."""

MOST_ENLARGED = 3.0
"""A depth image of a fisheye lens grows to at most so many times its width when it is straightened."""

NEAREST_SEEN_M = 0.2
"""What is nearer may get no depth at the rims of the colour image; an Azure Kinect measures nothing there."""

LEAST_AHEAD = 0.5
"""Share of a colour ray's depth that lies ahead of the depth camera, where the two look the same way."""

Registered = Float32[np.ndarray, "color_height color_width"]
"""Depth in metres at the pixels of the colour image; or a coordinate there, in pixels of the depth image."""


def registered(
    depth_m: DepthImage,
    depth_camera: Intrinsics,
    color_camera: Intrinsics,
    color_from_depth: Transform | None = None,
) -> Registered:
    """Depth at every pixel of the colour image, along the colour camera's axis; 0 = none.

    Args:
        depth_m: the depth image as it was measured.
        depth_camera: camera of the depth image, with its size.
        color_camera: camera of the colour image, with its size.
        color_from_depth: where the depth camera stands; None where both images come through one lens.
    """
    if color_from_depth is None:
        return _sampled(depth_m, depth_camera, _through_one_lens(depth_camera, color_camera))
    if depth_camera.distortion:
        straight = _straight(depth_camera, color_camera, tuple(invert(color_from_depth).ravel().tolist()))
        depth_m = _sampled(depth_m, depth_camera, _through_one_lens(depth_camera, straight))
        depth_camera = straight
    return _looked_up(depth_m, depth_camera, color_camera, color_from_depth)


@dataclass(frozen=True)
class _Lookup:
    """Where each pixel of the colour image lies in the depth image.

    Attributes:
        u, v: column and row, pixels.
        corner: the upper left one of the four depth pixels around; inside by one pixel at the rims.
        inside: whether it lies on the depth image at all, 1 or 0.
    """

    u: Registered
    v: Registered
    corner: Int16[np.ndarray, "color_height color_width 2"]
    inside: UInt8[np.ndarray, "color_height color_width"]

    @staticmethod
    def of(u: Registered, v: Registered, camera: Intrinsics) -> _Lookup:
        width, height = camera.width, camera.height
        corner = np.stack([np.floor(u).clip(0, width - 2), np.floor(v).clip(0, height - 2)], axis=-1)
        inside = (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5)
        return _Lookup(u, v, corner.astype(np.int16), inside.astype(np.uint8))


@lru_cache(maxsize=4)
def _straight(
    camera: Intrinsics, color_camera: Intrinsics, depth_from_color: tuple[float, ...]
) -> Intrinsics:
    """A camera without distortion that sees what this one and the colour camera see, in an image of any size.

    An Azure Kinect's depth would lose a quarter of its pixels in an image of the same size, and have nine
    times as many, in its wide mode, in one of all that it sees.
    """
    directions = _rays(camera)[:2].reshape(2, -1).astype(float)
    focal = np.array([camera.fx, camera.fy])
    limit = MOST_ENLARGED * np.array([camera.width, camera.height]) / focal / 2
    low, high = (side(directions, axis=1).clip(-limit, limit) for side in (np.min, np.max))
    least, most = _seen_by_color(color_camera, np.array(depth_from_color).reshape(4, 4))
    low, high = np.maximum(low, least), np.minimum(high, most)
    width, height = (max(int(side), 2) for side in np.ceil((high - low) * focal) + 1)
    cx, cy = (-low * focal).tolist()
    return Intrinsics(camera.fx, camera.fy, cx, cy, width, height)


def _seen_by_color(color_camera: Intrinsics, depth_from_color: Transform) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest x / z and y / z, in the depth camera's frame, of what the colour camera sees."""
    rotation, offset_m = _parts(depth_from_color)
    x, y, z = rotation @ _rays(color_camera).reshape(3, -1)
    if z.min() < LEAST_AHEAD:
        return np.full(2, -np.inf), np.full(2, np.inf)
    tangents = np.array([x / z, y / z])
    reach = 1 + np.abs(tangents).max()
    margin = np.linalg.norm(offset_m) * reach / (NEAREST_SEEN_M * LEAST_AHEAD)
    return tangents.min(axis=1) - margin, tangents.max(axis=1) + margin


def _without_distortion(camera: Intrinsics) -> Intrinsics:
    return replace(camera, distortion=())


@lru_cache(maxsize=4)
def _rays(camera: Intrinsics) -> Float32[np.ndarray, "3 height width"]:
    """Directions (z = 1) of the rays through all pixels."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    found = rays(camera, np.column_stack([u.ravel(), v.ravel()]).astype(float))
    return np.ascontiguousarray(found.T.reshape(3, camera.height, camera.width), dtype=np.float32)


@lru_cache(maxsize=4)
def _through_one_lens(depth_camera: Intrinsics, color_camera: Intrinsics) -> _Lookup:
    """Where the colour pixels lie in the depth image of a camera in the same place."""
    directions = _rays(color_camera).reshape(3, -1).T.astype(float)
    u, v = project(depth_camera, directions).T.astype(np.float32)
    shape = color_camera.height, color_camera.width
    return _Lookup.of(u.reshape(shape), v.reshape(shape), depth_camera)


# One lens -----------------------------------------------------------------------------------------


def _sampled(depth_m: DepthImage, camera: Intrinsics, lookup: _Lookup) -> Registered:
    """Depth at fractional pixels of the depth image: 1/z interpolated on a surface, the nearest at edges."""
    inverse = np.divide(1, depth_m, out=np.zeros_like(depth_m), where=depth_m > 0)
    between: Any = cv2.remap(inverse, lookup.u, lookup.v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    smooth: Any = _on_one_surface(depth_m, (camera.fx + camera.fy) / 2).view(np.uint8)
    whole_pixels: Any = None
    on_surface = cv2.remap(smooth, lookup.corner, whole_pixels, cv2.INTER_NEAREST) > 0
    nearest: Any = cv2.remap(depth_m, lookup.u, lookup.v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    found: Registered = np.divide(1, between, out=nearest, where=on_surface)
    found[lookup.inside == 0] = 0
    return found


def _on_one_surface(depth_m: DepthImage, focal_px: float) -> Bool[np.ndarray, "rows columns"]:
    """Whether the four pixels right of and below each one are measured, and lie on one surface."""
    rows_low, rows_high = np.minimum(depth_m[:-1], depth_m[1:]), np.maximum(depth_m[:-1], depth_m[1:])
    low = np.minimum(rows_low[:, :-1], rows_low[:, 1:])
    high = np.maximum(rows_high[:, :-1], rows_high[:, 1:])
    found: Bool[np.ndarray, "rows columns"] = (low > 0) & (high - low <= MAX_SLOPE / focal_px * low)
    return found


# Two lenses ---------------------------------------------------------------------------------------


def _looked_up(
    depth_m: DepthImage, depth_camera: Intrinsics, color_camera: Intrinsics, color_from_depth: Transform
) -> Registered:
    """Depth along the colour camera's rays: where a ray meets the depth image follows from the depth itself.

    The nearest depth splatted around the pixel is the start. Then the point at that depth is projected into
    the depth image, whose surface there gives a better one. What does not settle is hidden from the depth
    camera.
    """
    directions = _rays(color_camera)
    rotation, offset = (part.astype(np.float32) for part in _parts(invert(color_from_depth)))
    back, forward = color_from_depth[2, :3].astype(np.float32), np.float32(color_from_depth[2, 3])
    turned = np.tensordot(rotation, directions, axes=1)
    z = _splatted(depth_m, depth_camera, color_camera, color_from_depth)
    for _ in range(PASSES):
        before = z
        x, y, ahead = turned * z + offset[:, None, None]
        ahead = np.where(z > 0, ahead, 1)
        across, down = x / ahead, y / ahead
        u = np.where(z > 0, across * depth_camera.fx + depth_camera.cx, -1).astype(np.float32)
        v = np.where(z > 0, down * depth_camera.fy + depth_camera.cy, -1).astype(np.float32)
        measured = _sampled(depth_m, depth_camera, _Lookup.of(u, v, depth_camera))
        z = np.where(measured > 0, measured * (back[0] * across + back[1] * down + back[2]) + forward, 0)
    settled = np.abs(z - before) <= MAX_SLOPE / color_camera.fx * z
    return np.where(settled, z, 0).astype(np.float32)


def _parts(a_from_b: Transform) -> tuple[np.ndarray, np.ndarray]:
    return a_from_b[:3, :3], a_from_b[:3, 3]


def _splatted(
    depth_m: DepthImage, depth_camera: Intrinsics, color_camera: Intrinsics, color_from_depth: Transform
) -> Registered:
    """Depth of the nearest point around each colour pixel, by splatting all points into a coarse image."""
    factor = min(1.0, COARSE * depth_camera.fx / color_camera.fx)
    width, height = (max(1, round(factor * side)) for side in (color_camera.width, color_camera.height))
    coarse = resized(_without_distortion(color_camera), width=width, height=height)
    seen = depth_m > 0
    rotation, offset = _parts(color_from_depth)
    points = (_rays(depth_camera)[:, seen] * depth_m[seen]).T @ rotation.T + offset
    points = points[np.argsort(-points[:, 2])]  # of several in a pixel the last is kept: the nearest
    pixels = np.round(project(coarse, points))
    inside = ((pixels >= 0) & (pixels < [width, height])).all(axis=1)
    found = np.zeros((height, width), np.float32)
    columns, rows = pixels[inside].astype(np.int64).T
    found[rows, columns] = points[inside, 2]
    size = color_camera.width, color_camera.height
    return np.asarray(cv2.resize(found, size, interpolation=cv2.INTER_NEAREST), np.float32)
