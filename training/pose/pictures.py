"""Pictures of predicted poses: keypoints with their confidence and covariance, and the object's axes."""

from __future__ import annotations

import cv2
import numpy as np

from rpl_data.geometry import project, transform
from rpl_data.types import Intrinsics, KeypointModel

from ..masks.pictures import write_words
from .pipeline import LEAST_CONFIDENCE, SeenKeypoints

TRUE = (255, 255, 255)
FRAME = (255, 200, 0)
AXES = ((230, 60, 60), (60, 200, 60), (70, 110, 255))


def drawn(
    image: np.ndarray,
    seen: SeenKeypoints | None,
    pose: np.ndarray | None,
    intrinsics: Intrinsics,
    model: KeypointModel,
    *,
    true_px: np.ndarray | None = None,
) -> np.ndarray:
    """Draw what was predicted for one object on a copy of an RGB image.

    Args:
        seen: crop and keypoints: red to green by confidence, with the ellipse of two standard deviations
            where poses use them.
        pose: ``camera_from_object``; its axes start at the model's centre.
        model: in the same object frame.
        true_px: where the keypoints truly are: white crosses.
    """
    picture = image.copy()
    if seen is not None:
        _draw_keypoints(picture, seen)
    if pose is not None:
        _draw_axes(picture, pose, intrinsics, model)
    if true_px is not None:
        for u, v in true_px[np.isfinite(true_px).all(axis=1)]:
            cv2.drawMarker(picture, (round(u), round(v)), TRUE, cv2.MARKER_TILTED_CROSS, 8, 1, cv2.LINE_AA)
    return picture


def named(picture: np.ndarray, seen: SeenKeypoints, failure: str | None) -> np.ndarray:
    """Write an object's name, its score and why it has no pose above its crop; the same picture."""
    cx, cy, side = seen.square_px
    corner = max(2, round(cx - side / 2)), max(12, round(cy - side / 2) - 4)
    words = f"{seen.object} {seen.score:.2f}"
    write_words(picture, words if failure is None else f"{words}: {failure}", corner, FRAME)
    return picture


def close_up(picture: np.ndarray, square_px: np.ndarray, *, side_px: int = 240) -> np.ndarray:
    """Cut the square (cx, cy, side) out of a picture and resize it; black beyond the picture's edge."""
    cx, cy, side = square_px
    zoom = side_px / side
    out_from_picture = np.array([[zoom, 0, -zoom * (cx - side / 2)], [0, zoom, -zoom * (cy - side / 2)]])
    result: np.ndarray = cv2.warpAffine(picture, out_from_picture, (side_px, side_px), flags=cv2.INTER_AREA)
    return result


def _draw_keypoints(picture: np.ndarray, seen: SeenKeypoints) -> None:
    cx, cy, side = seen.square_px
    left, top, width = round(cx - side / 2), round(cy - side / 2), round(side)
    cv2.rectangle(picture, (left, top), (left + width, top + width), FRAME, 1)
    for (u, v), confidence, covariance in zip(
        seen.positions_px, seen.confidence, seen.covariance_px, strict=True
    ):
        color = (round(255 * (1 - confidence)), round(255 * confidence), 0)
        values, axes = np.linalg.eigh(covariance)
        cv2.circle(picture, (round(u), round(v)), 2, color, -1, cv2.LINE_AA)
        if confidence < LEAST_CONFIDENCE:
            continue
        lengths = np.minimum(2 * np.sqrt(values), side)
        angle = float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1])))
        size = (round(float(lengths[1])), round(float(lengths[0])))
        cv2.ellipse(picture, (round(u), round(v)), size, angle, 0, 360, color, 1, cv2.LINE_AA)


def _draw_axes(picture: np.ndarray, pose: np.ndarray, intrinsics: Intrinsics, model: KeypointModel) -> None:
    points = model.points_object[model.known]
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    length = 0.5 * float(np.ptp(points, axis=0).max())
    ends = project(intrinsics, transform(pose, np.vstack([centre, centre + length * np.eye(3)])))
    if not np.isfinite(ends).all() or np.abs(ends).max() > 1e4:
        return
    start = (round(ends[0, 0]), round(ends[0, 1]))
    for (u, v), color in zip(ends[1:], AXES, strict=True):
        cv2.line(picture, start, (round(u), round(v)), color, 2, cv2.LINE_AA)
