"""Clicks lifted to space (paper section III-B, Eq. 1), without trusting the depth at the pixel.

Keypoints sit on corners and edges, where a depth sensor bleeds: up to a third of the clicks land on
the background or on a hole. So a click keeps every surface that the sensor saw around it as a candidate,
nearest first, and the solve chooses between them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import depth_sigma_m, rays
from rpl_data.types import Click, DataError, DepthImage, Intrinsics, Observation, ReadDepth, Scene, Trajectory

RADIUS_PX = 14.0
"""Surfaces are searched within this distance of a click: a D435 loses 5-10 px at depth edges, and a person
clicks 2-3 px off."""
NEAR_PX = 5.0
"""Pixels at this distance from the click weigh half as much as those at the click."""
NEAREST_DEPTH_M = 0.05
"""Smallest depth that a surface can have."""
LIFT_SIGMA_M = 0.002
"""A plane through the pixels around a keypoint misses the keypoint by about this much, beyond the noise of
the sensor: edges are round, and a corner has more than one face."""
EDGE_SIGMA_M = 0.005
"""Where the surface fills at most half of the neighbourhood (the rest being other surfaces or holes), an edge
of the object is near, and the sensor blurs the depth on both sides of it by about this much."""
SLOPE_SIGMA_PX = 2.2
"""On a surface seen at a grazing angle, the depth error equals the change of depth over this many pixels."""
BEND_SHARE = 0.7
"""Where the measured surface is no plane (two faces that the sensor has rounded into one, a curved side), the
keypoint misses the fitted plane by about this share of what the pixels beside it do (on rendered objects 0.5,
on a rendered bowl 1.0, on a real cube 0.8)."""
STEEPEST = 4.0
"""Tangent of the angle between line of sight and normal to which a steeper fitted slope is limited."""


def lift_clicks(
    clicks: Iterable[Click],
    scenes: Mapping[str, Scene],
    trajectories: Mapping[str, Trajectory],
    depth_reader: Callable[[Scene], ReadDepth],
) -> list[Observation]:
    """Lift clicks to observations, in the same order.

    Every clicked depth image is read once, and only one is in memory at a time. A click in a frame without a
    depth image becomes a ray without candidates.

    Args:
        depth_reader: returns, for a scene, the function that reads its depth images.

    Raises:
        DataError: a click names an unknown scene or frame, a frame without a pose, or lies outside the
            image.
    """
    clicks = list(clicks)
    by_frame: dict[tuple[str, int], list[int]] = {}
    for number, click in enumerate(clicks):
        by_frame.setdefault((click.scene, click.frame), []).append(number)
    lifted: dict[int, Observation] = {}
    for (name, index), numbers in by_frame.items():
        first = clicks[numbers[0]]
        if name not in scenes:
            raise DataError(
                f"a click on keypoint {first.keypoint} of {first.object} is in scene {name!r}, "
                f"which is not in the workspace; the scenes are {', '.join(sorted(scenes))}"
            )
        scene = scenes[name]
        frame = scene.frame(index)
        pose = _pose(first, trajectories[name])
        size = (scene.intrinsics.height, scene.intrinsics.width)
        depth_m = np.zeros(size, np.float32) if frame.depth is None else depth_reader(scene)(frame)
        for number in numbers:
            lifted[number] = lift(clicks[number], scene.intrinsics, pose, depth_m)
    return [lifted[number] for number in range(len(clicks))]


def _pose(click: Click, trajectory: Trajectory) -> Float64[np.ndarray, "4 4"]:
    """`scene_from_camera` of the clicked frame; DataError naming the click when the frame has no pose."""
    try:
        return trajectory.at(click.frame)
    except DataError as error:
        raise DataError(
            f"object {click.object}, scene {click.scene}, a click in frame {click.frame}: {error}"
        ) from error


def lift(
    click: Click, intrinsics: Intrinsics, scene_from_camera: Float64[np.ndarray, "4 4"], depth_m: DepthImage
) -> Observation:
    """Lift one click to a ray with candidate surfaces.

    Raises:
        DataError: the click lies outside the image.
    """
    if not (0 <= click.u_px + 0.5 < intrinsics.width and 0 <= click.v_px + 0.5 < intrinsics.height):
        raise DataError(
            f"click on keypoint {click.keypoint} of {click.object}, scene {click.scene}, frame "
            f"{click.frame}: ({click.u_px:.1f}, {click.v_px:.1f}) px lies outside the image of "
            f"{intrinsics.width} x {intrinsics.height} px; delete it or give the pixels of the full image"
        )
    uv = np.array([[click.u_px, click.v_px]])
    pixel_rad = 2 / (intrinsics.fx + intrinsics.fy)
    found = candidate_surfaces(depth_m, click.u_px, click.v_px, pixel_rad=pixel_rad)
    return Observation(
        click=click,
        ray_camera=rays(intrinsics, uv)[0],
        scene_from_camera=scene_from_camera,
        depths_m=found.depths_m,
        depth_sigmas_m=found.sigmas_m,
        pixel_rad=pixel_rad,
        depth_slopes_m=found.slopes_m,
        pixel_depth_m=float(depth_m[round(click.v_px), round(click.u_px)]),
    )


class Candidates(NamedTuple):
    """The surfaces around a click, nearest first.

    Attributes:
        depths_m: depth of each at the click.
        sigmas_m: standard deviation of the keypoint's distance from the surface, along the line of sight.
        slopes_m: derivative of the depth by x and y of the ray, metres per unit.
    """

    depths_m: Float64[np.ndarray, " candidates"]
    sigmas_m: Float64[np.ndarray, " candidates"]
    slopes_m: Float64[np.ndarray, "candidates 2"]


class _Piece(NamedTuple):
    """Measured pixels of one surface: their depth, and their position relative to the click."""

    depth_m: np.ndarray
    du_px: np.ndarray
    dv_px: np.ndarray


def candidate_surfaces(depth_m: DepthImage, u_px: float, v_px: float, *, pixel_rad: float) -> Candidates:
    """Find the surfaces within `RADIUS_PX` of a pixel.

    The depths of the neighbourhood are sorted and split where they jump by more than the sensor's noise; a
    plane is fitted to each piece and extrapolated to the click.
    """
    pieces = _surfaces(depth_m, u_px, v_px)
    planes = np.array([_plane_at_click(piece) for piece in pieces], dtype=float).reshape(-1, 4)
    depths, slopes, bends = planes[:, 0], planes[:, 1:3] / pixel_rad, planes[:, 3]
    steepness = np.hypot(*slopes.T) / np.maximum(depths, NEAREST_DEPTH_M)
    slopes = slopes * np.minimum(1, STEEPEST / np.maximum(steepness, 1e-9))[:, None]
    nearest_px = np.array([np.hypot(piece.du_px, piece.dv_px).min() for piece in pieces], dtype=float)
    pixel_m = pixel_rad * depths
    filled = np.array([len(piece.depth_m) for piece in pieces], dtype=float) / (np.pi * RADIUS_PX**2)
    sigmas = np.sqrt(
        np.asarray(depth_sigma_m(depths)) ** 2
        + LIFT_SIGMA_M**2
        + (EDGE_SIGMA_M * np.clip(2 * (1 - filled), 0, 1)) ** 2
        + (SLOPE_SIGMA_PX * pixel_m * np.minimum(steepness, STEEPEST)) ** 2
        + (BEND_SHARE * bends) ** 2
        # Between the click and the nearest measured pixel the surface may bend by 45 degrees, and a steep one
        # may be as wrong in its slope.
        + (np.maximum(nearest_px - 1, 0) * pixel_m) ** 2 * (1 + np.minimum(steepness, STEEPEST) ** 2)
    )
    order = np.argsort(depths, kind="stable")
    return Candidates(depths[order], sigmas[order], slopes[order])


def _surfaces(depth_m: DepthImage, u_px: float, v_px: float) -> list[_Piece]:
    """Measured pixels within the radius, split into surfaces where the depth jumps."""
    height, width = depth_m.shape
    left, right = max(0, int(np.ceil(u_px - RADIUS_PX))), min(width, int(u_px + RADIUS_PX) + 1)
    top, bottom = max(0, int(np.ceil(v_px - RADIUS_PX))), min(height, int(v_px + RADIUS_PX) + 1)
    v, u = np.mgrid[top:bottom, left:right]
    du, dv = u - u_px, v - v_px
    window = depth_m[top:bottom, left:right].astype(float)
    measured = (window > 0) & (np.hypot(du, dv) <= RADIUS_PX)
    order = np.argsort(window[measured])
    depths, du, dv = window[measured][order], du[measured][order], dv[measured][order]
    jumps = np.diff(depths) > np.maximum(0.008, 4 * np.asarray(depth_sigma_m(depths[1:])))
    cuts = np.split(np.arange(len(depths)), np.flatnonzero(jumps) + 1)
    return [_Piece(depths[cut], du[cut], dv[cut]) for cut in cuts if len(cut) >= 4]


def _plane_at_click(piece: _Piece) -> tuple[float, float, float, float]:
    """Depth of the piece's plane at the click, its derivatives per pixel, and the bend, in metres.

    The bend is the root mean square distance of the pixels near the click from the plane.

    A robust fit of the inverse depth, which is linear in the pixel for a plane; pixels near the click weigh
    more. The small ridge on the slope keeps the plane of a thin piece from tilting wildly.
    """
    columns = np.column_stack([np.ones_like(piece.du_px), piece.du_px, piece.dv_px])
    near = np.exp2(-((piece.du_px**2 + piece.dv_px**2) / NEAR_PX**2))
    weights, inverse = near, np.zeros(3)
    for _ in range(4):
        ridge = np.diag([0.0, 1.0, 1.0]) * weights.sum()
        normal = (columns * weights[:, None]).T @ columns + ridge
        inverse = np.linalg.solve(normal, (columns * weights[:, None]).T @ (1 / piece.depth_m))
        errors_m = np.abs(columns @ inverse - 1 / piece.depth_m) * piece.depth_m**2
        weights = near / (1 + (errors_m / 0.006) ** 2)
    depth = float(np.clip(1 / inverse[0], 0.9 * piece.depth_m[0], 1.1 * piece.depth_m[-1]))
    misses_m = (columns @ inverse - 1 / piece.depth_m) * piece.depth_m**2
    bend = float(np.sqrt(near @ misses_m**2 / near.sum()))
    return depth, float(-inverse[1] * depth**2), float(-inverse[2] * depth**2), bend
