"""Small motions of the camera and how well they are known: the algebra that joins colour and depth.

A motion is six numbers (rotation vector, then translation) of the camera in its own frame; it changes a
pose to ``scene_from_camera @ moved(motion)``. That is also small_gicp's convention.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import Transform, invert, rigid

INDEPENDENT = 0.1
"""Neighbouring pixels and points err alike: each is worth this much of an independent measurement."""

LEVER_M = 0.7
"""A turn is as large as its arc at this distance, a usual one between camera and object."""

Motion = Float64[np.ndarray, "6"]
Information = Float64[np.ndarray, "6 6"]


@dataclass(frozen=True)
class Estimate:
    """A pose and how well it is known.

    Attributes:
        scene_from_camera: the pose.
        information: inverse covariance of the motion that would mend it; radians and metres.
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
    """Size of the motions from some poses to another, as `size_m` has it."""
    turned = (np.einsum("nij,ij->n", poses[:, :3, :3], scene_from_camera[:3, :3]) - 1) / 2  # cosines
    moved_m = np.linalg.norm(poses[:, :3, 3] - scene_from_camera[:3, 3], axis=1)
    sizes_m: Float64[np.ndarray, " n"] = np.hypot(moved_m, LEVER_M * np.arccos(np.clip(turned, -1, 1)))
    return sizes_m


def size_m(motion: Motion) -> float:
    """Size of a motion in metres, a turn as its arc at `LEVER_M`."""
    return float(np.hypot(np.linalg.norm(motion[3:]), LEVER_M * np.linalg.norm(motion[:3])))


def above_noise(information: Information, noise: Information) -> Information:
    """Information without what measurements of a featureless scene would show of their noise alone."""
    values, vectors = np.linalg.eigh(information - noise)
    left: Information = (vectors * np.maximum(values, 0)) @ vectors.T
    return left


def weakest_sigma_m(information: Information) -> float:
    """Standard deviation of the least known motion, a turn as its arc at `LEVER_M`; inf = not known."""
    scale = np.r_[np.full(3, 1 / LEVER_M), np.ones(3)]
    least = float(np.linalg.eigvalsh(information * np.outer(scale, scale))[0])
    return float("inf") if least <= 0 else least**-0.5
