"""Render painted objects, anti-aliased, with what hides what.

Rays are cast through a grid twice as fine as the image in both directions; a pixel is the mean of its four.
Labels need the image's own grid: their depth is cast through the centres of its pixels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from rpl_data.geometry import Transform, resized, transform
from rpl_data.raycast import PixelTable, rays_in_object
from rpl_data.synthesize.body import Body
from rpl_data.synthesize.light import Light, shade
from rpl_data.types import Intrinsics

FINER = 2
"""Rays per pixel along each axis."""

Depth = Float32[np.ndarray, "h w"]
"""Metres along the optical axis; inf = nothing there."""


@dataclass(frozen=True)
class Placed:
    """An object and where it is before the camera."""

    body: Body
    camera_from_object: Transform


@dataclass(frozen=True)
class Drawing:
    """Objects before nothing.

    Attributes:
        color: 0 to 255, multiplied by alpha.
        alpha: the share of each pixel that an object covers, 0 to 1.
    """

    color: Float32[np.ndarray, "h w 3"]
    alpha: Float32[np.ndarray, "h w"]


def finer_table(intrinsics: Intrinsics) -> PixelTable:
    """The rays of `draw` for all of an image."""
    return PixelTable.of(
        resized(intrinsics, width=FINER * intrinsics.width, height=FINER * intrinsics.height)
    )


def table_of(directions: Float64[np.ndarray, "h w 3"], intrinsics: Intrinsics) -> PixelTable:
    """A table of any rays of a camera, such as those of a turned crop."""
    x, y = directions[..., 0], directions[..., 1]
    ranges = np.array([x.min(axis=0), x.max(axis=0)]), np.array([y.min(axis=1), y.max(axis=1)])
    return PixelTable(intrinsics, directions.astype(np.float32), *ranges)


def draw(
    table: PixelTable, objects: list[Placed], lights: Mapping[str, Light], *, finer: int = FINER
) -> Drawing:
    """Draw objects; the nearest hides the others.

    Args:
        table: rays of a grid that is `finer` times as fine as the image.
        lights: by the object's name.
    """
    height, width = table.directions.shape[:2]
    nearest = np.full((height, width), np.inf, np.float32)
    color = np.zeros((height, width, 3), np.float32)
    for placed in objects:
        _draw_one(table, placed, lights[placed.body.name], nearest, color)
    size = width // finer, height // finer
    alpha = np.isfinite(nearest).astype(np.float32)
    if finer == 1:
        return Drawing(color, alpha)
    return Drawing(
        cv2.resize(color, size, interpolation=cv2.INTER_AREA),
        cv2.resize(alpha, size, interpolation=cv2.INTER_AREA),
    )


def _draw_one(
    table: PixelTable,
    placed: Placed,
    light: Light,
    nearest: Depth,
    color: Float32[np.ndarray, "h w 3"],
) -> None:
    """Draw an object over what is farther, into `nearest` and `color`."""
    body, pose = placed.body, placed.camera_from_object
    window = table.window(transform(pose, body.hull))
    if window is None:
        return
    hits = body.rays.cast(rays_in_object(table.directions[window], pose))
    before = np.flatnonzero(hits.t < nearest[window].ravel())
    # `take` gathers rows several times as fast as indexing does.
    texel = body.painted.texel_at(hits.triangle_id.take(before), hits.uv.take(before, axis=0))
    normals = body.normals.take(texel, axis=0)
    shaded = shade(normals @ pose[:3, :3].T.astype(np.float32), light)
    rows, columns = np.divmod(before, window[1].stop - window[1].start)
    pixels = (rows + window[0].start) * nearest.shape[1] + columns + window[1].start
    nearest.reshape(-1)[pixels] = hits.t.take(before)
    color.reshape(-1, 3)[pixels] = shaded * body.colors.take(texel, axis=0)


@dataclass(frozen=True)
class Alone:
    """An object in the image as if nothing hid it.

    Attributes:
        depth_m: in the window; inf where the object is not.
        unseen: share of its pixels that show surface which no camera saw, or the inside of the mesh.
    """

    window: tuple[slice, slice]
    depth_m: Depth
    unseen: float

    @property
    def mask(self) -> Bool[np.ndarray, "h w"]:
        """Where the object is."""
        return np.asarray(np.isfinite(self.depth_m))


def alone(table: PixelTable, placed: Placed) -> Alone | None:
    """Cast an object at the centres of the image's pixels; None where it is out of view."""
    body, pose = placed.body, placed.camera_from_object
    window = table.window(transform(pose, body.hull))
    if window is None:
        return None
    directions = table.directions[window]
    rays = rays_in_object(directions, pose)
    hits = body.rays.cast(rays)
    hit = np.isfinite(hits.t)
    if not hit.any():
        return None
    inside_out = np.einsum("nd,nd->n", hits.normals[hit], rays[hit, 3:]) > 0
    unseen = ~body.painted.seen[hits.triangle_id[hit]] | inside_out
    return Alone(window, hits.t.reshape(directions.shape[:2]), float(unseen.mean()))
