"""Relocalise the camera after the track was lost, by matching corners of a frame to those of a keyframe."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from rpl_data.geometry import Transform, invert, rigid
from rpl_data.reconstruct.view import Level

FEATURES = 500
LEAST_MATCHES = 15
NEAR_PX = 3.0
"""Largest reprojection error of an inlier, in pixels of the small image; the alignment that follows
refines."""


@dataclass(frozen=True)
class Landmarks:
    """Corners of an image with known depth (ORB; Rublee et al., ICCV 2011).

    Attributes:
        points: their positions in the camera frame.
        uv_px: their pixels.
        descriptors: 256 bits each.
    """

    points: Float32[np.ndarray, "n 3"]
    uv_px: Float32[np.ndarray, "n 2"]
    descriptors: UInt8[np.ndarray, "n 32"]


def landmarks_of(level: Level) -> Landmarks:
    """Detect the corners of an image that have depth."""
    orb = cv2.ORB.create(nfeatures=FEATURES, fastThreshold=7)
    corners, descriptors = orb.detectAndCompute(level.grey.astype(np.uint8), None)
    if descriptors is None:
        descriptors = np.zeros((0, 32), np.uint8)
    uv_px = np.array([corner.pt for corner in corners], dtype=np.float32).reshape(-1, 2)
    columns, rows = np.rint(uv_px).astype(int).T
    depth_m = level.depth_m[rows, columns]
    camera = level.camera
    xy = (uv_px - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    points = (np.column_stack([xy, np.ones(len(xy))]) * depth_m[:, None]).astype(np.float32)
    known = depth_m > 0
    return Landmarks(points[known], uv_px[known], descriptors[known])


def keyframe_from_camera(level: Level, here: Landmarks, there: Landmarks) -> Transform | None:
    """Compute the pose of a camera relative to a keyframe from their landmarks; None where too few agree.

    Args:
        level: the image that `here` was found in.
        here: landmarks of the frame.
        there: landmarks of the keyframe.
    """
    if min(len(here.points), len(there.points)) < LEAST_MATCHES:
        return None
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(here.descriptors, there.descriptors)
    if len(pairs) < LEAST_MATCHES:
        return None
    mine, theirs = np.array([(pair.queryIdx, pair.trainIdx) for pair in pairs]).T
    ok, rotvec, translation_m, inliers = cv2.solvePnPRansac(
        there.points[theirs].astype(float),
        here.uv_px[mine].astype(float),
        level.camera.matrix,
        None,
        reprojectionError=NEAR_PX,
        iterationsCount=200,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    if not ok or inliers is None or len(inliers) < LEAST_MATCHES:
        return None
    camera_from_keyframe = rigid(cv2.Rodrigues(rotvec)[0], translation_m.ravel())
    return invert(camera_from_keyframe)
