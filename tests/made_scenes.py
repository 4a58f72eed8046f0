"""A wall with print and things before it, seen by a camera on a known path: for the tests of tracking."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from rpl_data.geometry import from_rotvec, invert, rays, rotation_angle_rad
from rpl_data.reconstruct.path import Track, collected
from rpl_data.reconstruct.tracking import track
from rpl_data.types import DepthImage, Frame, GreyImage, Intrinsics, Scene, Trajectory

Spoil = Callable[[GreyImage], GreyImage]

CAMERA = Intrinsics(300.0, 300.0, 159.5, 119.5, 320, 240)
FRAMES = 24


def orbit(count: int = FRAMES) -> np.ndarray:
    """A camera that goes sideways, looks back and comes a little nearer; the first pose is the identity."""
    turn, way = np.array([0.02, -0.25, 0.1]), np.array([0.22, -0.02, 0.08])
    return np.array([from_rotvec(s * turn, s * way) for s in np.linspace(0, 1, count)])


def brightness(points: np.ndarray, contrast: float) -> np.ndarray:
    """A print that goes through all of space: waves of 2 to 12 cm in all directions."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(12, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True) * rng.uniform(0.02, 0.12, (12, 1))
    waves = np.cos(2 * np.pi * (points @ directions.T) + rng.uniform(0, 6, 12))
    return 128 + contrast * waves.sum(axis=1)


def shot(
    scene_from_camera: np.ndarray,
    *,
    boxes: bool,
    contrast: float,
    rng: np.random.Generator,
    noise: float = 1.0,
    wall_m: float = 0.9,
) -> tuple[GreyImage, DepthImage]:
    """Small brightness and depth of a wall ahead of the first camera, with things 0.8 m ahead or not."""
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    directions = (
        rays(CAMERA, np.column_stack([u.ravel(), v.ravel()]).astype(float)) @ scene_from_camera[:3, :3].T
    )
    origin = scene_from_camera[:3, 3]
    t = wall_t = (wall_m - origin[2]) / directions[:, 2]
    for x, y, z, half in (
        ((-0.15, 0.1, 0.8, 0.08), (0.12, 0.05, 0.75, 0.07), (0.05, -0.12, 0.82, 0.06)) if boxes else ()
    ):
        across = np.sort(([x, y, z] - origin + half * np.array([-1, 1])[:, None, None]) / directions, axis=0)
        enters, leaves = across[0].max(axis=1), across[1].min(axis=1)
        t = np.where(enters < leaves, np.minimum(t, enters), t)
    points = origin + directions * t[:, None]
    points[t == wall_t] *= 0.9 / wall_m  # a far wall has a larger print
    grey = brightness(points, contrast) + noise * rng.normal(0, 2, len(t))
    depth_m = t + noise * rng.normal(0, 0.001, len(t)) * (t / 0.7) ** 2
    small = grey.reshape(CAMERA.height // 2, 2, CAMERA.width // 2, 2).mean(axis=(1, 3))
    return small.clip(0, 255).round().astype(np.uint8), depth_m.reshape(u.shape).astype(np.float32)


def scene_of(count: int) -> Scene:
    return Scene("made", CAMERA, 0.001, tuple(Frame(k, k / 30, Path("c"), Path("d")) for k in range(count)))


def tracked(
    poses: np.ndarray,
    *,
    boxes: bool = True,
    contrast: float = 10.0,
    blind: tuple[int, ...] = (),
    spoilt: Mapping[int, Spoil] | None = None,
    wall_m: float = 0.9,
) -> Track:
    """The track of shots from those poses.

    Args:
        blind: frames in which the camera sees no depth.
        spoilt: what happens to the brightness of some frames.
    """
    scene, rng = scene_of(len(poses)), np.random.default_rng(1)
    shots = {}
    for frame, pose in zip(scene.frames, poses, strict=True):
        grey, depth_m = shot(pose, boxes=boxes, contrast=contrast, rng=rng, wall_m=wall_m)
        grey = (spoilt or {}).get(frame.index, lambda grey: grey)(grey)
        shots[frame.index] = grey, np.zeros_like(depth_m) if frame.index in blind else depth_m
    images = ((frame, *shots[frame.index]) for frame in scene.frames)
    return collected(scene, track(scene, images, again=lambda frame: shots[frame.index]))


def errors(trajectory: Trajectory, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Millimetres and degrees from the truth, whose first pose is the identity."""
    wrong = invert(poses[trajectory.frames]) @ trajectory.scene_from_camera
    degrees = np.rad2deg([rotation_angle_rad(pose[:3, :3]) for pose in wrong])
    return np.linalg.norm(wrong[:, :3, 3], axis=1) * 1e3, degrees
