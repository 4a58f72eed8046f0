"""How well the clicks of a scene fit the mirror image of the object: left for right in every image.

The mirror image is that about the middle of the object in each image. It predicts both coordinates of
every click from the keypoints and one pose, six unknowns in all. From afar, a mirror image in one frame is
nearly that of the object turned about; what tells them apart is perspective, or another frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from rpl_data.geometry import from_rotvec, transform
from rpl_data.solve.click_rays import NEAREST_DEPTH_M, Rays

FITS = 0.01
"""A mirror image is rejected when right ones would fit as badly in a smaller share of scenes."""
FEWEST_KEYPOINTS = 4
"""With three keypoints a pose always fits."""
TURNS = 400
"""Orientations of the object from which the best ones are refined."""
STARTS = 5
"""How many of them are refined."""
STEPS = 20
"""Gauss-Newton steps of each."""
ENOUGH = 1e-2
"""Change of the cost at which a fit ends."""
SMALL = 1e-6
"""Step of the finite differences, in radians and metres."""
FAR_PX = 60.0
"""A mirrored keypoint farther than this from its click counts as this far when starts are compared."""


class Mirrored(NamedTuple):
    """The clicks of one scene, and what all other scenes know of their keypoints.

    Attributes:
        column: place in `points` of each click's keypoint.
        points: the keypoints in the model frame, metres.
        covariance: of all their coordinates together, in m^2.
        centre: about the middle of the object in the scene, metres.
        sigma_px: standard deviation of a click in each axis.
    """

    rays: Rays
    column: Int64[np.ndarray, " n"]
    points: Float64[np.ndarray, "k 3"]
    covariance: Float64[np.ndarray, "c c"]
    centre: Float64[np.ndarray, " 3"]
    sigma_px: float


def mirrored_cost(scene: Mirrored, *, most: float) -> float:
    """Squared distance of the clicks from the mirror image of the object, in standard deviations.

    Infinite when it is more than `most` or than right mirror images have.
    """
    if len(scene.points) < FEWEST_KEYPOINTS:
        return np.inf
    most = min(most, float(chi2.isf(FITS, 2 * len(scene.column) - 6)))
    costs = (_refined_cost(scene, pose, most=most) for pose in _starts(scene))
    return next((cost for cost in costs if cost < most), np.inf)


def _starts(scene: Mirrored) -> Iterator[Float64[np.ndarray, "4 4"]]:
    """Orientations of the object about its place in which the mirrored clicks fit best."""
    poses = np.tile(np.eye(4), (TURNS, 1, 1))
    poses[:, :3, :3] = Rotation.random(TURNS, rng=np.random.default_rng(0)).as_matrix()
    poses[:, :3, 3] = scene.centre - poses[:, :3, :3] @ scene.points.mean(axis=0)
    squared = _residuals(scene, poses, scene.points[None]) ** 2
    costs = np.minimum(squared, (FAR_PX / scene.sigma_px) ** 2).sum(axis=1)
    yield from poses[np.argsort(costs)[:STARTS]]


def _residuals(
    scene: Mirrored, poses: Float64[np.ndarray, "b 4 4"], points: Float64[np.ndarray, "#b k 3"]
) -> Float64[np.ndarray, "b r"]:
    """Mirrored keypoints minus clicks, in standard deviations, for a stack of poses and of points.

    `points` holds one set for all poses, or one per pose. In the image of each click, u becomes
    u_min + u_max - u, with the least and the largest u of all keypoints there.
    """
    in_scene = points @ poses[:, :3, :3].swapaxes(1, 2) + poses[:, None, :3, 3]
    turns = scene.rays.camera_from_scene[:, :3, :3]
    in_camera = (in_scene @ turns.transpose(2, 0, 1).reshape(3, -1)).reshape(*in_scene.shape[:2], -1, 3)
    in_camera += scene.rays.camera_from_scene[:, :3, 3]
    xy = in_camera[..., :2] / np.maximum(in_camera[..., 2:], NEAREST_DEPTH_M)  # pose, keypoint, click
    own = xy[:, scene.column, np.arange(len(scene.column))]
    across = xy[..., 0].min(axis=1) + xy[..., 0].max(axis=1)
    mirrored = np.stack([across - own[..., 0], own[..., 1]], axis=-1)
    sigma = scene.rays.pixel_rad[:, None] * scene.sigma_px
    residuals: Float64[np.ndarray, "b r"] = ((mirrored - scene.rays.xy) / sigma).reshape(len(xy), -1)
    return residuals


def _refined_cost(scene: Mirrored, pose: Float64[np.ndarray, "4 4"], *, most: float) -> float:
    """The least squared distance from a start, weighted by the clicks' and the keypoints' covariance.

    The fit is given up when its last step, repeated as often as is left, would not bring it below `most`.
    """
    damping, cost = 1e-2, np.inf
    for left in reversed(range(STEPS)):
        residuals, by_pose, by_points = _linearised(scene, pose)
        covariance = np.eye(len(residuals)) + by_points @ scene.covariance @ by_points.T
        weighted = np.linalg.solve(covariance, np.column_stack([residuals, by_pose]))
        before, cost = cost, float(residuals @ weighted[:, 0])
        normal, gradient = by_pose.T @ weighted[:, 1:], by_pose.T @ weighted[:, 0]
        if abs(before - cost) < ENOUGH or cost - most > left * abs(before - cost):
            break
        while damping < 1e4:
            step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)
            there = _turned_and_moved(scene, pose, step)
            tried = _residuals(scene, there[None], scene.points[None])[0]
            if tried @ np.linalg.solve(covariance, tried) < cost:
                break
            damping *= 10
        else:
            break
        pose, damping = there, damping / 10
    return cost


def _linearised(
    scene: Mirrored, pose: Float64[np.ndarray, "4 4"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residuals, and their derivatives by the pose and by the keypoints (finite differences)."""
    count = scene.points.size
    poses = np.stack(
        [pose, *(_turned_and_moved(scene, pose, step) for step in SMALL * np.eye(6)), *[pose] * count]
    )
    points = np.tile(scene.points, (len(poses), 1, 1))
    points[7:] += SMALL * np.eye(count).reshape(count, -1, 3)
    found = _residuals(scene, poses, points)
    by = ((found[1:] - found[0]) / SMALL).T
    return found[0], by[:, :6], by[:, 6:]


def _turned_and_moved(
    scene: Mirrored, pose: Float64[np.ndarray, "4 4"], step: Float64[np.ndarray, " 6"]
) -> Float64[np.ndarray, "4 4"]:
    """The pose turned about the middle of the object by the first three, in radians, then moved."""
    middle = transform(pose, scene.points.mean(axis=0))
    turn = from_rotvec(step[:3], np.zeros(3))
    there: Float64[np.ndarray, "4 4"] = turn @ pose
    there[:3, 3] = turn[:3, :3] @ (pose[:3, 3] - middle) + middle + step[3:]
    return there
