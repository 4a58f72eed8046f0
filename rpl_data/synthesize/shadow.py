"""Shadows of objects on their table."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float32

from rpl_data.geometry import invert
from rpl_data.raycast import PixelTable
from rpl_data.synthesize.light import Light
from rpl_data.synthesize.render import Placed
from rpl_data.synthesize.studio import Plane

COARSER = 4
"""Shadows are soft: one ray per so many pixels along each axis."""
SOFT_PX = 3.0
"""Standard deviation of a shadow's edge, pixels of the image."""
SLANT = 1.2
"""A lamp is taken to stand at least so steeply: the tangent of its angle off the vertical."""
OF_LIGHT = 0.8
"""Share of the uneven part of the light that comes from the one direction that casts the shadow."""
REACH = 3.0
"""Farthest shadow, in radii of the object."""


def shadows(
    table: PixelTable, objects: Sequence[Placed], plane: Plane, light: Light
) -> Float32[np.ndarray, "height width"] | None:
    """Factors on the brightness of the table; None where the light comes evenly from all sides."""
    lamp = light.light_from_camera.T @ light.coefficients[1:4].mean(axis=1)
    strength = float(np.linalg.norm(lamp) / max(light.coefficients[0].mean(), 1e-6))
    across = lamp - (lamp @ plane.normal) * plane.normal
    if strength < 0.02:
        return None
    steep = max(float(lamp @ plane.normal), float(np.linalg.norm(across)) / SLANT, 1e-6)
    towards = across + steep * plane.normal
    towards /= np.linalg.norm(towards)
    directions = table.directions[COARSER // 2 :: COARSER, COARSER // 2 :: COARSER].reshape(-1, 3)
    along = directions @ plane.normal
    z_m = np.where(along < -1e-3, plane.offset_m / np.minimum(along, -1e-3), np.nan)
    points = directions * z_m[:, None]
    dark = np.zeros(len(points), np.float32)
    for placed in objects:
        reach_m = placed.body.radius_m * REACH
        near = np.flatnonzero(np.linalg.norm(points - placed.camera_from_object[:3, 3], axis=1) < reach_m)
        if len(near):
            dark[near] = np.maximum(dark[near], _blocked(placed, points[near], towards))
    height, width = table.directions.shape[:2]
    shape = len(range(COARSER // 2, height, COARSER)), len(range(COARSER // 2, width, COARSER))
    soft = cv2.GaussianBlur(dark.reshape(shape), (0, 0), SOFT_PX / COARSER)
    full = cv2.resize(soft, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(1 - np.float32(min(OF_LIGHT * strength, 0.6)) * full, dtype=np.float32)


def _blocked(placed: Placed, points: np.ndarray, towards: np.ndarray) -> Float32[np.ndarray, " n"]:
    """1 where an object stands between a point and the lamp."""
    object_from_camera = invert(placed.camera_from_object)
    start = points @ object_from_camera[:3, :3].T + object_from_camera[:3, 3]
    way = np.broadcast_to(object_from_camera[:3, :3] @ towards, start.shape)
    rows = np.hstack([start + 0.002 * way, way]).astype(np.float32)
    return placed.body.rays.occluded(rows, far=10.0).astype(np.float32)
