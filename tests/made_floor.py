"""A floor with blocks on it, seen by a hand-held camera: exact depth without a renderer."""

from __future__ import annotations

import numpy as np

from rpl_data.geometry import from_rotvec, rays
from rpl_data.types import Intrinsics

CAMERA = Intrinsics(300.0, 300.0, 158.0, 121.0, 320, 240)


def pose(n: int) -> np.ndarray:
    """A hand-held camera 0.8 m above a floor, swinging to and fro."""
    swing = np.array([0.10 * np.sin(n / 4), 0.14 * np.sin(n / 5 + 1), 0.05 * np.sin(n / 3)])
    return from_rotvec(swing, np.array([0.12 * np.sin(n / 6), 0.08 * np.cos(n / 5), -0.8]))


def shoot(scene_from_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colour and exact depth of a floor (z = 0) with blocks of several heights on it."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    directions = rays(CAMERA, np.column_stack([u.ravel(), v.ravel()]).astype(float))
    toward = directions @ scene_from_camera[:3, :3].T
    origin = scene_from_camera[:3, 3]
    depth_m = -origin[2] / toward[:, 2]
    points = origin + depth_m[:, None] * toward
    grey = 90 + 12 * np.sin(60 * points[:, 0]) * np.sin(47 * points[:, 1])
    rng = np.random.default_rng(3)
    for _ in range(7):
        x, y = rng.uniform(-0.35, 0.35, 2)
        wide, height, shade = rng.uniform(0.04, 0.09), rng.uniform(0.08, 0.2), rng.uniform(0, 255)
        top_m = (-height - origin[2]) / toward[:, 2]  # z points down, so tops have negative z
        hit = origin + top_m[:, None] * toward
        on_top = (abs(hit[:, 0] - x) < wide) & (abs(hit[:, 1] - y) < wide) & (top_m < depth_m)
        depth_m = np.where(on_top, top_m, depth_m)
        grey = np.where(on_top, shade, grey)
    shape = (CAMERA.height, CAMERA.width)
    color = np.repeat(grey.reshape(shape)[..., None], 3, axis=2).clip(0, 255).astype(np.uint8)
    return color, depth_m.reshape(shape)
