"""Poses of one object, estimated in single frames of a scene where it stands still: what they agree on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from rpl_data.geometry import Points, Transform, fit_rigid, transform, transform_all

FEWEST = 3
"""Frames that must agree: two wrong poses are alike by chance, or by one view seen twice."""

WITHIN = 0.15
"""Poses agree whose keypoints are apart by less than this share of the object's size, root mean square."""

FARTHER = 2.0
"""Labels stray that are farther from the images' pose than this times the images' own median distance.

Right labels of the twin were never more than 1.6 times as far, by networks that the factor was chosen with.
"""

FEWEST_TO_JUDGE = 8
"""Agreeing images from which their median distance means anything."""

NO_TURN = np.eye(4)[None]
"""What leaves an object without symmetry looking the same."""


@dataclass(frozen=True)
class Agreement:
    """A pose on which several frames agree.

    Attributes:
        scene_from_object: the pose in their middle, metres.
        members: numbers of the given poses that agree with it.
        off_m: how far each of them is from the middle: distance of the keypoints, root mean square.
    """

    scene_from_object: Transform
    members: Int64[np.ndarray, " m"]
    off_m: Float64[np.ndarray, " m"]


def agreements(
    scene_from_object: Float64[np.ndarray, "p 4 4"],
    points_object: Points,
    same: Float64[np.ndarray, "s 4 4"] = NO_TURN,
) -> list[Agreement]:
    """Group poses of one object in one scene, the largest group first.

    Args:
        scene_from_object: one pose per frame.
        points_object: the keypoints, object frame, metres.
        same: turns after which the object looks the same (`symmetry_transforms`); poses that differ by one of
            them agree.
    """
    points = transform_all(scene_from_object, points_object)
    turned = np.array([transform_all(pose @ same, points_object) for pose in scene_from_object])
    apart_m = np.array([_apart_m(turned, one).min(axis=1) for one in points]).reshape(2 * (len(points),))
    near = apart_m < WITHIN * _size_m(points_object)
    left: Bool[np.ndarray, " p"] = np.ones(len(points), dtype=bool)
    found = []
    while left.any():
        votes = (near & left).sum(axis=1) * left
        first = int(votes.argmax())
        members = np.flatnonzero(near[first] & left)
        if len(members) < FEWEST:
            break
        alike = _apart_m(turned[members], points[first]).argmin(axis=1)
        found.append(_agreement(turned[members, alike], members, points_object))
        left[members] = False
    return found


def _apart_m(
    points: Float64[np.ndarray, "m s n 3"], other: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "m s"]:
    """Distances of keypoints in one pose from those in many, root mean square."""
    found: Float64[np.ndarray, "m s"] = np.sqrt(((points - other) ** 2).sum(axis=3).mean(axis=2))
    return found


def nearest_pose(
    pose: Transform,
    points: Points,
    same: Float64[np.ndarray, "s 4 4"],
    *,
    to: Transform,
    points_to: Points,
) -> Transform:
    """Of the poses in which an object looks the same, the one whose keypoints are nearest to another pose's.

    Arguments as in `agreements` and `keypoint_distance_m`.
    """
    alike = pose @ same
    nearest: Transform = min(alike, key=lambda one: keypoint_distance_m(one, points, to, points_to))
    return nearest


def keypoint_distance_m(one: Transform, points_one: Points, other: Transform, points_other: Points) -> float:
    """How far two poses put the keypoints apart, root mean square; models may be in different frames.

    NaN where a keypoint has no position in one of the models; those do not count.
    """
    apart = transform(one, points_one) - transform(other, points_other)
    return float(np.sqrt(np.nanmean((apart**2).sum(axis=1))))


def labels_stray(apart_m: float, off_m: Sequence[float]) -> bool:
    """Whether labels are farther from the pose on which images agree than their scatter explains.

    Args:
        apart_m: of the labels from that pose (`keypoint_distance_m`).
        off_m: of each image from it (`Agreement.off_m`).
    """
    return len(off_m) >= FEWEST_TO_JUDGE and apart_m > FARTHER * float(np.median(off_m))


def _agreement(
    points: Float64[np.ndarray, "m n 3"], members: Int64[np.ndarray, " m"], points_object: Points
) -> Agreement:
    """The middle of some poses, by the median of each keypoint's positions: a few far ones do not pull it."""
    middle = fit_rigid(np.median(points, axis=0), points_object)
    off = points - transform(middle, points_object)
    return Agreement(middle, members, np.sqrt((off**2).sum(axis=2).mean(axis=1)))


def _size_m(points_object: Points) -> float:
    """The largest distance between two keypoints."""
    return float(np.linalg.norm(points_object[:, None] - points_object[None], axis=2).max())
