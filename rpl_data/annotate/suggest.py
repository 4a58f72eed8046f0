"""Suggest frames to click in: sharp, near, and each from another side. Few pictures are read for it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

from rpl_data.annotate.stores.scenes import PosedScene
from rpl_data.geometry import inside_image, invert, project
from rpl_data.images import read_grey
from rpl_data.types import DataError

MOST, LEAST = 6, 3
"""Number of suggestions per scene; from the same side if there is no other."""
APART_RAD = np.radians(12)
"""Frames from nearly the same side are not suggested twice."""
OPENED = 4
"""Number of neighbouring pictures whose sharpness is compared, per suggestion."""


@dataclass(frozen=True)
class Suggestion:
    """A frame, and why it is worth a click."""

    frame: int
    why: str


def suggest_frames(posed: PosedScene, centre_scene: Float64[np.ndarray, "3"] | None) -> list[Suggestion]:
    """Suggest at most `MOST` frames, in their order.

    Args:
        centre_scene: position of the object in the scene frame, metres; None for the point the cameras look
            at.
    """
    rows = np.flatnonzero(np.isin(posed.trajectory.frames, list(posed.frames)))
    poses = posed.trajectory.scene_from_camera[rows]
    if not len(rows):
        return []
    centre = looked_at(poses) if centre_scene is None else centre_scene
    towards = poses[:, :3, 3] - centre
    distance_m = np.linalg.norm(towards, axis=1)
    speed = blur_rad(poses, distance_m)
    usable = _in_view(posed, poses, centre)
    if not usable.any():
        usable[:] = True
    chosen = _spread(towards / distance_m[:, None], usable, distance_m, speed)
    sides = len(chosen)
    found: dict[int, str] = {}
    for number, row in enumerate(_with_slow_ones(chosen, usable, speed)):
        sharpest = _sharpest_near(posed, rows, row, usable, speed)
        why = "near and sharp" if number == 0 else "sharp, new side" if number < sides else "sharp"
        found.setdefault(int(posed.trajectory.frames[rows[sharpest]]), why)
    return [Suggestion(frame, why) for frame, why in sorted(found.items())]


def looked_at(poses: Float64[np.ndarray, "n 4 4"]) -> Float64[np.ndarray, "3"]:
    """Point nearest to all optical axes (least squares), 0.7 m ahead when they are parallel."""
    axes, centres = poses[:, :3, 2], poses[:, :3, 3]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    ahead = centres + 0.7 * axes
    normal = across.sum(axis=0) + 1e-3 * len(poses) * np.eye(3)
    right = np.einsum("nij,nj->i", across, centres) + 1e-3 * ahead.sum(axis=0)
    point: Float64[np.ndarray, "3"] = np.linalg.solve(normal, right)
    return point


def blur_rad(
    poses: Float64[np.ndarray, "n 4 4"], distance_m: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Angle that the view turns between a frame and its neighbours: a fast camera blurs."""
    if len(poses) < 2:
        return np.zeros(len(poses))
    turned = np.arccos(np.clip((poses[1:, :3, 2] * poses[:-1, :3, 2]).sum(axis=1), -1, 1))
    moved = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / np.maximum(distance_m[1:], 0.1)
    step = turned + moved
    fastest: Float64[np.ndarray, " n"] = np.maximum(np.append(step, step[-1]), np.insert(step, 0, step[0]))
    return fastest


def _in_view(posed: PosedScene, poses: Float64[np.ndarray, "n 4 4"], centre: np.ndarray) -> np.ndarray:
    """Which frames show the centre in the middle part of the image."""
    camera = posed.scene.intrinsics
    in_camera = np.einsum("nij,j->ni", invert(poses), np.append(centre, 1.0))[:, :3]
    uv = project(camera, in_camera)
    middle = np.array([camera.width, camera.height]) / 2
    return inside_image(camera, (uv - middle) * 1.2 + middle)


def _spread(
    directions: np.ndarray, usable: np.ndarray, distance_m: np.ndarray, speed: np.ndarray
) -> list[int]:
    """Choose rows whose directions are far apart, starting with a near and slow one."""
    cost = distance_m / np.median(distance_m) + 0.5 * speed / max(float(np.median(speed)), 1e-9)
    chosen = [int(np.where(usable, cost, np.inf).argmin())]
    while len(chosen) < MOST:
        cosines = (directions @ directions[chosen].T).max(axis=1)
        apart = np.where(usable, np.arccos(np.clip(cosines, -1, 1)), 0)
        if apart.max() < APART_RAD:
            break
        chosen.append(int(apart.argmax()))
    return chosen


def _with_slow_ones(chosen: list[int], usable: np.ndarray, speed: np.ndarray) -> list[int]:
    """Add slow rows, apart from the chosen ones in time, if those are few."""
    more, apart = list(chosen), max(1, len(speed) // (2 * LEAST))
    for row in np.argsort(speed, kind="stable"):
        if len(more) >= LEAST:
            break
        if usable[row] and all(abs(int(row) - other) >= apart for other in more):
            more.append(int(row))
    return more


def _sharpest_near(
    posed: PosedScene, rows: np.ndarray, row: int, usable: np.ndarray, speed: np.ndarray
) -> int:
    """Among the slowest neighbours of a row, choose the one whose picture has most detail."""
    reach = max(1, min(8, len(rows) // 40))
    near = np.arange(max(0, row - reach), min(len(rows), row + reach + 1))
    near = near[usable[near]] if usable[near].any() else near
    slowest = near[np.argsort(speed[near], kind="stable")][:OPENED]
    return int(max(slowest, key=lambda r: _detail(posed, int(posed.trajectory.frames[rows[r]]))))


def _detail(posed: PosedScene, frame: int) -> float:
    """Variance of the Laplacian of the picture at half its size; 0 if it cannot be read."""
    try:
        image = read_grey(posed.frame(frame), reduce=2)
    except DataError:
        return 0.0
    return float(cv2.Laplacian(image, cv2.CV_32F).var())
