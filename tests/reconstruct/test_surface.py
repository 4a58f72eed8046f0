"""The fused surface: where it lies, and what colour it has."""

from __future__ import annotations

import numpy as np
from made_scenes import brightness, orbit, scene_of, shot

from rpl_data.geometry import Sphere
from rpl_data.reconstruct.fused_frames import frames_to_fuse
from rpl_data.reconstruct.surface import fuse_surface, fuse_surfaces
from rpl_data.types import ColorImage, DepthImage, Frame, Mesh, Trajectory

CONTRAST = 10.0
TINT = np.array([1.0, 0.7, 0.4])
"""Three different channels, so that their order is tested too."""


def fused_wall() -> Mesh:
    poses = orbit(6)
    shots = [shot(pose, boxes=False, contrast=CONTRAST, rng=np.random.default_rng(3)) for pose in poses]
    scene = scene_of(len(poses))

    def color(frame: Frame) -> ColorImage:
        grey = shots[frame.index][0].astype(float).repeat(2, axis=0).repeat(2, axis=1)
        return np.round(grey[..., None] * TINT).astype(np.uint8)

    return fuse_surface(
        scene,
        Trajectory(np.arange(len(poses)), poses),
        scene.frames,
        lambda frame: shots[frame.index][1],
        centre_scene=np.array([0.0, 0.0, 0.9]),
        radius_m=0.12,
        colors=color,
    )


def test_the_surface_has_the_colours_of_the_images() -> None:
    mesh = fused_wall()
    assert mesh.colors is not None
    assert np.abs(mesh.vertices[:, 2] - 0.9).max() < 0.005
    expected = brightness(mesh.vertices, CONTRAST)[:, None].clip(0, 255) * TINT
    error = np.abs(mesh.colors - expected)
    assert np.median(error) < 4
    assert expected[:, 0].std() > 20, "the wall must have a print, or its colours say nothing"
    print_found = np.corrcoef(mesh.colors[:, 0], expected[:, 0])[0, 1]
    assert print_found > 0.97


def test_a_long_recording_is_fused_from_all_sides_by_its_steadiest_frames() -> None:
    """30 sides, each passed 40 times at different speeds; a fast frame of a side is never preferred."""
    rng = np.random.default_rng(5)
    side = np.tile(np.repeat(np.arange(30), 4), 10)
    shake = rng.uniform(0, 1, len(side))
    poses = np.tile(np.eye(4), (len(side), 1, 1))
    poses[:, 0, 3] = 0.02 * side + 0.001 * shake * np.where(np.arange(len(side)) % 2, 1, -1)
    scene, centre = scene_of(len(side)), np.array([[0.3, 0.0, 0.9]])
    chosen = frames_to_fuse(
        scene, Trajectory(np.arange(len(side)), poses), scene.frames, centres_scene=centre, most=30
    )
    rows = [frame.index for frame in chosen]
    assert len(rows) == 30 and rows == sorted(rows)
    sides = np.unique(np.rint(poses[rows, 0, 3] / 0.02))
    assert len(sides) >= 25, "nearly every side is seen"
    step = np.abs(np.diff(poses[:, 0, 3]))
    motion = np.maximum(np.r_[step[0], step], np.r_[step, step[-1]])
    assert np.median(motion[rows]) < 0.5 * np.median(motion)


def test_a_camera_on_a_tripod_is_fused_from_as_many_frames_as_any() -> None:
    scene = scene_of(50)
    still = Trajectory(np.arange(50), np.tile(np.eye(4), (50, 1, 1)))
    centre = np.array([[0.0, 0.0, 0.9]])
    assert len(frames_to_fuse(scene, still, scene.frames, centres_scene=centre, most=20)) == 20
    assert frames_to_fuse(scene, still, scene.frames[:20], centres_scene=centre, most=20) == list(
        scene.frames[:20]
    )


def test_several_spheres_are_fused_in_one_pass_over_the_frames() -> None:
    poses = orbit(6)
    shots = [shot(pose, boxes=False, contrast=CONTRAST, rng=np.random.default_rng(3)) for pose in poses]
    scene, read = scene_of(len(poses)), []

    def depths(frame: Frame) -> DepthImage:
        read.append(frame.index)
        return shots[frame.index][1]

    spheres = [Sphere(np.array([x, 0.0, 0.9]), 0.1) for x in (-0.06, 0.06)]
    trajectory = Trajectory(np.arange(len(poses)), poses)
    both = fuse_surfaces(scene, trajectory, scene.frames, depths, spheres=spheres)
    assert len(read) == len(set(read))
    for mesh, sphere in zip(both, spheres, strict=True):
        alone = fuse_surface(
            scene, trajectory, scene.frames, depths, centre_scene=sphere.centre_m, radius_m=sphere.radius_m
        )
        assert {tuple(v) for v in mesh.vertices} == {tuple(v) for v in alone.vertices}
        assert np.linalg.norm(mesh.vertices - sphere.centre_m, axis=1).max() < 0.11
