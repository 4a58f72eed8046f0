"""A printed egg on which the scenes see overlapping sides, and clicks on its keypoints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rpl_data.geometry import from_rotvec, invert, transform
from rpl_data.types import PointCloud

RADII = np.array([0.05, 0.05, 0.07])
"""Round about its third axis: geometry alone does not know how far it is turned about that."""
SCENES = 3


def print_at(points: np.ndarray) -> np.ndarray:
    """A coloured print that goes through space: waves of 2 to 5 cm."""
    rng = np.random.default_rng(5)
    waves = []
    for _ in range(3):
        directions = rng.normal(size=(6, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True) * rng.uniform(0.02, 0.05, (6, 1))
        waves.append(np.cos(2 * np.pi * points @ directions.T + rng.uniform(0, 6, 6)).sum(axis=1))
    return (128 + 25 * np.column_stack(waves)).clip(0, 255).round().astype(np.uint8)


def egg_seen_from(side: np.ndarray, *, seed: int, exposure: float = 1.0, printed: bool = True) -> PointCloud:
    """Points of the half that faces a side, every 3 mm or so with 0.3 mm noise; object frame."""
    rng = np.random.default_rng(seed)
    on_ball = rng.normal(size=(6000, 3))
    on_ball /= np.linalg.norm(on_ball, axis=1, keepdims=True)
    normals = on_ball / RADII
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    seen = normals @ side / np.linalg.norm(side) > -0.3
    points = on_ball[seen] * RADII
    colors = (exposure * print_at(points)).clip(0, 255).round().astype(np.uint8)
    noisy = points + normals[seen] * rng.normal(0, 0.0003, (len(points), 1))
    return PointCloud(noisy, normals[seen], colors if printed else None)


def moved(cloud: PointCloud, b_from_a: np.ndarray) -> PointCloud:
    return PointCloud(transform(b_from_a, cloud.points), cloud.normals @ b_from_a[:3, :3].T, cloud.colors)


@dataclass(frozen=True)
class PointClicks:
    """Clicks as points in their scenes; a stand-in for the rays of the solve, with the same unknowns."""

    clicked: np.ndarray  # (scenes, keypoints, 3)
    sigma_m: float

    def terms(self, poses: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        unknowns = 6 * len(poses) + points.size
        normal, gradient = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
        for s, pose in enumerate(poses):
            for k, point in enumerate(points):
                here = transform(pose, point[None])[0]
                jacobian = np.zeros((3, unknowns))
                x, y, z = here
                jacobian[:, 6 * s : 6 * s + 3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
                jacobian[:, 6 * s + 3 : 6 * s + 6] = np.eye(3)
                first = 6 * len(poses) + 3 * k
                jacobian[:, first : first + 3] = pose[:3, :3]
                normal += jacobian.T @ jacobian / self.sigma_m**2
                gradient += jacobian.T @ (here - self.clicked[s, k]) / self.sigma_m**2
        return normal, gradient

    def costs(self, poses: np.ndarray, points: np.ndarray) -> np.ndarray:
        found = np.stack([transform(pose, points) for pose in poses])
        return ((found - self.clicked) ** 2).sum(axis=(1, 2)) / self.sigma_m**2


@dataclass(frozen=True)
class Made:
    """The true poses and keypoints, a start some millimetres and degrees away, and the evidence."""

    true_poses: np.ndarray
    points: np.ndarray
    start: np.ndarray
    regions: dict[str, PointCloud]
    clicks: PointClicks

    def turned_deg(self, poses: np.ndarray) -> float:
        """Largest rotation by which a scene is off relative to the first one."""
        wrong = [
            poses[0] @ invert(poses[s]) @ self.true_poses[s] @ invert(self.true_poses[0]) for s in (1, 2)
        ]
        return max(np.degrees(np.arccos(np.clip((np.trace(w[:3, :3]) - 1) / 2, -1, 1))) for w in wrong)

    def apart_mm(self, poses: np.ndarray) -> float:
        """Largest distance by which a scene's keypoints are off relative to the first scene."""
        wrong = [
            invert(self.true_poses[s]) @ poses[s] @ invert(poses[0]) @ self.true_poses[0] for s in (1, 2)
        ]
        return 1e3 * max(np.linalg.norm(transform(w, self.points) - self.points, axis=1).max() for w in wrong)


def made(*, printed: bool = True, off_m: float = 0.003, off_rad: float = 0.06, seed: int = 0) -> Made:
    rng = np.random.default_rng(seed)
    true_poses = np.stack([from_rotvec(rng.normal(0, 1, 3), rng.normal(0, 0.3, 3)) for _ in range(SCENES)])
    points = np.array([[0.05, 0, 0], [-0.05, 0, 0], [0, 0.05, 0], [0, -0.05, 0], [0, 0, 0.07], [0, 0, -0.07]])
    sides = np.array([[1.0, 0, 0.3], [-0.5, 0.9, 0], [-0.5, -0.9, -0.3]])
    nudges = [from_rotvec(rng.normal(0, off_rad, 3), rng.normal(0, off_m, 3)) for _ in range(SCENES)]
    start = true_poses @ np.stack(nudges)
    clicked = np.stack([transform(pose, points) for pose in start])
    regions = {
        str(s): moved(
            egg_seen_from(sides[s], seed=seed + s, exposure=(1.0, 0.8, 1.1)[s], printed=printed),
            true_poses[s],
        )
        for s in range(SCENES)
    }
    return Made(true_poses, points, start, regions, PointClicks(clicked, 0.006))
