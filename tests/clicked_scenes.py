"""A made-up object clicked in made-up scenes: lifted clicks without images."""

import numpy as np
from scipy.spatial.transform import Rotation

from rpl_data.geometry import invert, rays, rigid, transform
from rpl_data.types import Click, Intrinsics, Observation

CAMERA = Intrinsics(600.0, 600.0, 320.0, 240.0, 640, 480)
CUBE = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.05, 0.05)])
CUBE = CUBE + np.random.default_rng(5).uniform(-0.01, 0.01, CUBE.shape)  # no symmetry
NAMES = tuple("abcdefgh")


def pose(random, distance_m=0.7):
    return rigid(Rotation.random(rng=random).as_matrix(), np.array([0.0, 0.0, distance_m]))


def click_scene(name, points, scene_from_object, cameras, random, noise_px=0.0, depths=None, keypoints=None):
    """Observations of points by cameras (scene_from_camera); `depths` may replace the candidates."""
    observations = []
    for frame, scene_from_camera in enumerate(cameras):
        in_camera = transform(invert(scene_from_camera) @ scene_from_object, points)
        uv = (
            in_camera[:, :2] / in_camera[:, 2:] * 600
            + [320, 240]
            + random.normal(0, noise_px, (len(points), 2))
        )
        for k in range(len(points)) if keypoints is None else keypoints:
            z = in_camera[k, 2]
            candidates = np.array([z] if depths is None else depths(k, frame, z), dtype=float)
            click = Click("cube", int(k), name, frame, float(uv[k, 0]), float(uv[k, 1]))
            observations.append(
                Observation(
                    click,
                    rays(CAMERA, uv[k : k + 1])[0],
                    scene_from_camera,
                    candidates,
                    0.0025 + 0 * candidates,
                    1 / 600,
                    pixel_depth_m=float(candidates[0]) if len(candidates) else 0.0,
                )
            )
    return observations


def cameras(n, spread_rad=0.3):
    """Cameras around a point 0.7 m ahead of the first."""
    pivot = rigid(np.eye(3), np.array([0, 0, 0.7]))
    turns = [Rotation.from_rotvec([0, a, 0]).as_matrix() for a in np.linspace(0, spread_rad, n)]
    return [pivot @ rigid(turn, np.zeros(3)) @ invert(pivot) for turn in turns]
