"""Clicks, and clicks lifted to space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True)
class Click:
    """A mark that a person set: keypoint number `keypoint` of `object`, at (u_px, v_px) of a frame.

    Attributes:
        scene: the scene; with the instance behind a slash where several are told apart (`types.instances`).
    """

    object: str
    keypoint: int
    scene: str
    frame: int
    u_px: float
    v_px: float


@dataclass(frozen=True)
class Observation:
    """A click lifted to 3D: a ray, and the depths that the sensor measured around it.

    Attributes:
        ray_camera: direction of the ray with z = 1, lens distortion removed; a point on it at
            depth d is ``d * ray_camera`` in the camera frame.
        scene_from_camera: pose of the clicked frame.
        depths_m: candidate depths from the neighbourhood, nearest surface first; may be empty.
        depth_sigmas_m: standard deviation of each candidate as the depth of the clicked point.
        pixel_rad: angle of one pixel there, 1 / focal length.
        depth_slopes_m: how each candidate's surface is tilted: the derivative of its depth by x and y of
            the ray, in metres per unit; None = every surface faces the camera.
        pixel_depth_m: what the sensor measured at the clicked pixel itself; 0 = nothing.
    """

    click: Click
    ray_camera: Float64[np.ndarray, "3"]
    scene_from_camera: Float64[np.ndarray, "4 4"]
    depths_m: Float64[np.ndarray, " candidates"]
    depth_sigmas_m: Float64[np.ndarray, " candidates"]
    pixel_rad: float
    depth_slopes_m: Float64[np.ndarray, "candidates 2"] | None = None
    pixel_depth_m: float = 0.0
