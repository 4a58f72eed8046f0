"""Small camera motions and their information matrices, by which colour and depth are combined.

A motion is six numbers (rotation vector, then translation) in the camera's own frame; it changes a
pose to ``scene_from_camera @ moved(motion)``. That is also small_gicp's convention.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import Transform, invert, rigid

INDEPENDENT = 0.1
"""Errors of neighbouring pixels and points are correlated, so each counts as this share of an independent
measurement."""

LEVER_M = 0.7
"""A rotation counts as long as its arc at this distance, which is typical between camera and object."""

Motion = Float64[np.ndarray, "6"]
Information = Float64[np.ndarray, "6 6"]


@dataclass(frozen=True)
class Estimate:
    """A pose and its certainty.

    Attributes:
        scene_from_camera: the pose.
        information: inverse covariance of the motion that corrects the pose; radians and metres.
    """

    scene_from_camera: Transform
    information: Information


def moved(motion: Motion) -> Transform:
    """The transform of a small motion."""
    return rigid(cv2.Rodrigues(motion[:3])[0], motion[3:])


def motion_between(a: Transform, b: Transform) -> Motion:
    """The motion that takes pose `a` to pose `b`: ``b = a @ moved(motion)``."""
    change = invert(a) @ b
    return np.concatenate([cv2.Rodrigues(change[:3, :3])[0].ravel(), change[:3, 3]])


def distances_m(
    poses: Float64[np.ndarray, "n 4 4"], scene_from_camera: Transform
) -> Float64[np.ndarray, " n"]:
    """Size of the motion from each of some poses to another pose, as defined by `size_m`."""
    turned = (np.einsum("nij,ij->n", poses[:, :3, :3], scene_from_camera[:3, :3]) - 1) / 2  # cosines
    moved_m = np.linalg.norm(poses[:, :3, 3] - scene_from_camera[:3, 3], axis=1)
    sizes_m: Float64[np.ndarray, " n"] = np.hypot(moved_m, LEVER_M * np.arccos(np.clip(turned, -1, 1)))
    return sizes_m


def size_m(motion: Motion) -> float:
    """Size of a motion in metres; a rotation counts as its arc at `LEVER_M`."""
    return float(np.hypot(np.linalg.norm(motion[3:]), LEVER_M * np.linalg.norm(motion[:3])))


def above_noise(information: Information, noise: Information) -> Information:
    """Information less that which noise alone would give in a featureless scene."""
    values, vectors = np.linalg.eigh(information - noise)
    left: Information = (vectors * np.maximum(values, 0)) @ vectors.T
    return left


def weakest_sigma_m(information: Information) -> float:
    """Standard deviation of the least known motion, a turn as its arc at `LEVER_M`; inf = not known."""
    scale = np.r_[np.full(3, 1 / LEVER_M), np.ones(3)]
    least = float(np.linalg.eigvalsh(information * np.outer(scale, scale))[0])
    return float("inf") if least <= 0 else least**-0.5
