"""The error to be expected of a scene's labels in pixels, and of keypoints where only the pose was found."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import NEAREST_M, invert, transform
from rpl_data.motions import cross_matrices
from rpl_data.pose.projection import projected_variance
from rpl_data.types import Intrinsics


def expected_px(
    covariance: Float64[np.ndarray, "k 3 3"],
    points: Float64[np.ndarray, "k 3"],
    intrinsics: Intrinsics,
    frame_from_camera: Float64[np.ndarray, "f 4 4"],
) -> float:
    """Root mean square error of the projected keypoints over all frames of a scene.

    Each covariance is propagated to first order through the pinhole projection; keypoints behind a camera do
    not count.

    Args:
        covariance: of the points, along the axes of their frame: that of the scene or that of the object.
        frame_from_camera: to the same frame, per image.
    """
    known = np.isfinite(points).all(axis=1)
    squares = []
    for camera_from_frame in invert(frame_from_camera):
        ahead = transform(camera_from_frame, points[known])[:, 2] > NEAREST_M
        squares.append(
            2
            * projected_variance(
                intrinsics, camera_from_frame, points[known][ahead], covariance[known][ahead]
            )
        )
    return float(np.sqrt(np.concatenate(squares).mean()))


def covariance_by_pose(
    pose_covariance: Float64[np.ndarray, "6 6"],
    scene_from_object: Float64[np.ndarray, "4 4"],
    points_object: Float64[np.ndarray, "k 3"],
    covariance: Float64[np.ndarray, "k 3 3"],
) -> Float64[np.ndarray, "k 3 3"]:
    """Covariance of keypoints in a scene, from that of the pose and that of the model's shape.

    Args:
        pose_covariance: of rotation and translation, applied on the left of the pose.
        covariance: of the keypoints in the object frame.
    """
    in_scene, turn = transform(scene_from_object, points_object), scene_from_object[:3, :3]
    by_pose = np.concatenate([-cross_matrices(in_scene), np.tile(np.eye(3), (len(in_scene), 1, 1))], axis=2)
    total: Float64[np.ndarray, "k 3 3"] = (
        by_pose @ pose_covariance @ np.swapaxes(by_pose, 1, 2) + turn @ covariance @ turn.T
    )
    return total
