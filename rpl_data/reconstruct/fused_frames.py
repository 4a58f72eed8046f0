"""Choose the frames of a long recording that are worth fusing: from all sides, and the steadiest of each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int64

from rpl_data.geometry import Points, invert, project, transform_all
from rpl_data.types import Frame, Scene, Trajectory

MOST_FRAMES = 300
"""Frames that are fused per scene. More do not improve the surface: their noise is averaged out by then."""


def steady_frames(
    scene: Scene,
    trajectory: Trajectory,
    *,
    centre_scene: Float64[np.ndarray, "3"],
    same_view_rad: float = 0.17,
    excess: float = 1.5,
    still_px: float = 1.0,
) -> set[int]:
    """Choose the frames worth fusing: fast ones only where no slower one saw the same side.

    While a hand-held camera moves fast, rolling shutter and the lag between colour and depth make its pose
    wrong by up to the image motion per frame (25 px on a real recording, 2 px in its slow frames). One such
    frame blurs the surface.

    Args:
        same_view_rad: frames whose directions to the centre differ by less than this see the same side.
        excess: a frame may move this many times faster than the slowest frame of the same side.
        still_px: frames with less image motion than this are always used.

    Returns:
        Their `Frame.index`.
    """
    if len(trajectory.frames) < 3:
        return set(trajectory.frames.tolist())
    motion_px = _motion_px(scene, trajectory, centre_scene)
    views = trajectory.scene_from_camera[:, :3, 3] - centre_scene
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    slowest_px = np.concatenate(  # not all at once: a table of all pairs would grow with the square
        [
            np.where(part @ views.T > np.cos(same_view_rad), motion_px, np.inf).min(axis=1)
            for part in np.array_split(views, len(views) // 500 + 1)
        ]
    )
    kept = motion_px <= np.maximum(excess * slowest_px, still_px)
    return set(trajectory.frames[kept].tolist())


def frames_to_fuse(
    scene: Scene,
    trajectory: Trajectory,
    frames: Sequence[Frame],
    *,
    centres_scene: Float64[np.ndarray, "c 3"],
    most: int = MOST_FRAMES,
) -> list[Frame]:
    """Choose at most `most` frames, so that all sides of some places are seen from as near as they were.

    The viewpoints are divided into cells, about centres that lie as far from one another as possible. Of each
    cell the steadiest frame is taken, which is also the sharpest: motion is what blurs. While there is room,
    the next steadiest of each cell follow.

    Args:
        frames: those to choose from, each with a pose.
        centres_scene: the places that are looked at, such as the objects' centres; scene frame.

    Returns:
        The chosen frames, in their order.
    """
    if len(frames) <= most:
        return list(frames)
    rows = np.searchsorted(trajectory.frames, [frame.index for frame in frames])
    motion_px = np.max([_motion_px(scene, trajectory, centre) for centre in centres_scene], axis=0)[rows]
    cells = _cells(_viewpoints(trajectory.scene_from_camera[rows, :3, 3], centres_scene), most)
    order = np.lexsort((motion_px, cells))  # cell by cell, the steadiest first
    starts = np.searchsorted(cells[order], cells[order])
    rank_in_cell = np.arange(len(order)) - starts
    chosen = order[np.lexsort((motion_px[order], rank_in_cell))][:most]
    return [frames[row] for row in np.sort(chosen)]


def _motion_px(
    scene: Scene, trajectory: Trajectory, centre_scene: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, " n"]:
    """Image motion per frame of what surrounds a place, at each pose: the larger of before and after."""
    camera_from_scene = invert(trajectory.scene_from_camera)
    cube = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = transform_all(camera_from_scene, centre_scene + cube)
    uv = project(scene.intrinsics, corners.reshape(-1, 3)).reshape(len(corners), len(cube), 2)
    step_px = np.nan_to_num(np.linalg.norm(np.diff(uv, axis=0), axis=2), nan=np.inf).max(axis=1)
    step_px = step_px / np.maximum(np.diff(trajectory.frames), 1)
    motion_px: Float64[np.ndarray, " n"] = np.maximum(np.r_[step_px[0], step_px], np.r_[step_px, step_px[-1]])
    return motion_px


def _viewpoints(cameras: Points, centres_scene: Float64[np.ndarray, "c 3"]) -> Float64[np.ndarray, "n m"]:
    """Where cameras look at the places from: the direction, and the logarithm of the distance, of each."""
    offsets = cameras[:, None] - centres_scene
    distances_m = np.linalg.norm(offsets, axis=2, keepdims=True)
    return np.concatenate([offsets / distances_m, np.log(distances_m)], axis=2).reshape(len(cameras), -1)


def _cells(viewpoints: Float64[np.ndarray, "n m"], most: int) -> Int64[np.ndarray, " n"]:
    """Divide viewpoints into at most so many cells, about centres as far from one another as possible."""
    cells = np.zeros(len(viewpoints), dtype=np.int64)
    nearest = ((viewpoints - viewpoints[0]) ** 2).sum(axis=1)
    for number in range(1, most):
        farthest = int(nearest.argmax())
        if not nearest[farthest]:  # all others lie on a centre
            break
        distance = ((viewpoints - viewpoints[farthest]) ** 2).sum(axis=1)
        nearer: Bool[np.ndarray, " n"] = distance < nearest
        cells[nearer], nearest[nearer] = number, distance[nearer]
    return cells
