"""Clicks lifted to space (paper section III-B, Eq. 1), without trusting the depth at the pixel.

Keypoints sit on corners and edges, where a depth sensor bleeds: up to a third of the clicks land on
the background or on a hole. So a click keeps every surface the sensor saw around it, nearest first;
the solve decides between them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import depth_sigma_m, rays
from rpl_data.types import Click, DataError, DepthImage, Frame, Intrinsics, Observation, Scene, Trajectory

RADIUS_PX = 9.0
"""A D435 loses about 5 px at depth edges, and a hand is off by 2-3 px."""


def lift_clicks(
    clicks: Iterable[Click],
    scenes: Mapping[str, Scene],
    trajectories: Mapping[str, Trajectory],
    read_depth: Callable[[Scene, Frame], DepthImage],
) -> list[Observation]:
    """Lift clicks; every clicked depth image is read once.

    Raises:
        DataError: a click names an unknown scene or frame, or lies outside the image.
    """
    images: dict[tuple[str, int], DepthImage] = {}
    observations = []
    for click in clicks:
        if click.scene not in scenes:
            raise DataError(
                f"a click on keypoint {click.keypoint} of {click.object} is in scene {click.scene!r}, "
                f"which is not in the workspace; the scenes are {', '.join(sorted(scenes))}"
            )
        scene = scenes[click.scene]
        frame = scene.frame(click.frame)
        key = (click.scene, click.frame)
        if key not in images:
            images[key] = read_depth(scene, frame)
        pose = trajectories[click.scene].at(click.frame)
        observations.append(lift(click, scene.intrinsics, pose, images[key]))
    return observations


def lift(
    click: Click, intrinsics: Intrinsics, scene_from_camera: Float64[np.ndarray, "4 4"], depth_m: DepthImage
) -> Observation:
    """One click as a ray with candidate depths.

    Raises:
        DataError: the click lies outside the image.
    """
    if not (0 <= click.u_px + 0.5 < intrinsics.width and 0 <= click.v_px + 0.5 < intrinsics.height):
        raise DataError(
            f"click on keypoint {click.keypoint} of {click.object}, scene {click.scene}, frame {click.frame}: "
            f"({click.u_px:.1f}, {click.v_px:.1f}) px lies outside the image of {intrinsics.width} x "
            f"{intrinsics.height} px; delete it or give the pixels of the full-size image"
        )
    uv = np.array([[click.u_px, click.v_px]])
    return Observation(
        click=click,
        ray_camera=rays(intrinsics, uv)[0],
        scene_from_camera=scene_from_camera,
        depths_m=candidate_depths_m(depth_m, click.u_px, click.v_px),
        pixel_rad=2 / (intrinsics.fx + intrinsics.fy),
    )


def candidate_depths_m(depth_m: DepthImage, u_px: float, v_px: float) -> Float64[np.ndarray, " candidates"]:
    """Depths of the surfaces within `RADIUS_PX` of a position, nearest surface first.

    The depths of the neighbourhood are sorted and cut where they jump by more than a sensor's noise;
    of each piece, the depth nearest to the click counts most (weighted median).
    """
    depths, distances_px = _neighbourhood(depth_m, u_px, v_px)
    order = np.argsort(depths)
    depths, distances_px = depths[order], distances_px[order]
    jumps = np.diff(depths) > np.maximum(0.008, 4 * np.asarray(depth_sigma_m(depths[1:])))
    pieces = np.split(np.arange(len(depths)), np.flatnonzero(jumps) + 1)
    return np.array(
        [
            _weighted_median(depths[p], np.exp(-0.5 * (distances_px[p] / 3) ** 2))
            for p in pieces
            if len(p) >= 4
        ]
    )


def _neighbourhood(depth_m: DepthImage, u_px: float, v_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Measured depths within the radius, and how far away each is in pixels."""
    height, width = depth_m.shape
    left, right = max(0, int(np.ceil(u_px - RADIUS_PX))), min(width, int(u_px + RADIUS_PX) + 1)
    top, bottom = max(0, int(np.ceil(v_px - RADIUS_PX))), min(height, int(v_px + RADIUS_PX) + 1)
    v, u = np.mgrid[top:bottom, left:right]
    distance_px = np.hypot(u - u_px, v - v_px)
    window = depth_m[top:bottom, left:right].astype(float)
    measured = (window > 0) & (distance_px <= RADIUS_PX)
    return window[measured], distance_px[measured]


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    """Of sorted values."""
    cumulative = np.cumsum(weights)
    return float(values[np.searchsorted(cumulative, cumulative[-1] / 2)])
