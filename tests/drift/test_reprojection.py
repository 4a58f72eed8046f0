"""Depth reprojection error: nothing for true poses, the error itself for wrong ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rpl_data.drift.reprojection import depth_reprojection_error_m, reprojection_over_gap
from rpl_data.geometry import from_rotvec, invert, rays
from rpl_data.images import depth_reader
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DepthImage, Frame, Intrinsics, Scene, Trajectory

CAMERA = Intrinsics(300.0, 300.0, 159.5, 119.5, 320, 240)
WALL_M = 1.0
POSES = np.array([from_rotvec(np.array([0, 0.02 * k, 0]), np.array([0.01 * k, 0, 0])) for k in range(9)])


def wall_depth_m(scene_from_camera: np.ndarray) -> DepthImage:
    """Depth of the plane z = `WALL_M` of the scene."""
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    directions = rays(CAMERA, np.column_stack([u.ravel(), v.ravel()]).astype(float))
    depth_m = (WALL_M - scene_from_camera[2, 3]) / (directions @ scene_from_camera[2, :3])
    return depth_m.reshape(u.shape).astype(np.float32)


def read_wall(frame: Frame) -> DepthImage:
    return wall_depth_m(POSES[frame.index])


def wall_scene(missing: int | None = None) -> Scene:
    depths = [None if k == missing else Path("wall.png") for k in range(len(POSES))]
    frames = tuple(Frame(k, k / 30, Path("wall.jpg"), depth) for k, depth in enumerate(depths))
    return Scene("wall", CAMERA, 0.001, frames)


def test_true_poses_have_no_error_and_a_step_towards_the_wall_is_the_error() -> None:
    early, late = POSES[0], POSES[8]
    depths = wall_depth_m(early), wall_depth_m(late)
    assert depth_reprojection_error_m(CAMERA, invert(early) @ late, *depths) < 1e-4
    wrong = from_rotvec(np.zeros(3), np.array([0, 0, 0.005])) @ late
    assert depth_reprojection_error_m(CAMERA, invert(early) @ wrong, *depths) == pytest.approx(
        0.005, abs=2e-4
    )


def test_a_third_of_the_pixels_hidden_does_not_matter() -> None:
    early, late = wall_depth_m(POSES[0]), wall_depth_m(POSES[1])
    early[:, :100] = 0.4
    assert depth_reprojection_error_m(CAMERA, invert(POSES[0]) @ POSES[1], early, late) < 1e-3


def test_views_apart_cannot_be_compared() -> None:
    away = from_rotvec(np.array([0, np.pi, 0]), np.zeros(3))
    assert np.isnan(depth_reprojection_error_m(CAMERA, away, *[wall_depth_m(np.eye(4))] * 2))


def test_points_that_come_to_lie_behind_or_beside_the_camera_are_left_out() -> None:
    """A lens, and a pose that takes half of the wall behind the camera: no warning, no number from there."""
    lens = replace(CAMERA, distortion=(0.1, -0.2, 0.001, 0.001, 0.05))
    for turn in (0.3, 1.2, 1.6, 2.5):
        wrong = from_rotvec(np.array([0, turn, 0]), np.array([0, 0, -0.9]))
        depth_reprojection_error_m(lens, wrong, *[wall_depth_m(np.eye(4))] * 2)


def test_pairs_over_a_gap_skip_frames_without_pose_or_depth() -> None:
    trajectory = Trajectory(np.array([0, 1, 2, 3, 5, 6, 7, 8]), np.delete(POSES, 4, axis=0))
    found = reprojection_over_gap(wall_scene(missing=6), trajectory, gap=3, read_depth=read_wall)
    assert found.pairs.tolist() == [[0, 3], [2, 5], [5, 8]]
    assert found.median_m < 1e-4
    few = reprojection_over_gap(wall_scene(), trajectory, gap=3, read_depth=read_wall, most_pairs=2)
    assert few.pairs.tolist() == [[0, 3], [5, 8]]
    assert np.isnan(reprojection_over_gap(wall_scene(), trajectory, gap=20, read_depth=read_wall).median_m)


def test_given_poses_of_the_kitchen_drift_as_they_were_measured_to(real_data: Path) -> None:
    recording = open_scenes(real_data / "kitchen", "frames")[0]
    assert recording.trajectory is not None
    found = reprojection_over_gap(
        recording.scene, recording.trajectory, gap=30, read_depth=depth_reader(recording.scene)
    )
    assert 0.008 < found.median_m < 0.016
