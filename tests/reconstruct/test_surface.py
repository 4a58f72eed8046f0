"""The fused surface: where it lies, and what colour it has."""

from __future__ import annotations

import numpy as np
from made_scenes import brightness, orbit, scene_of, shot

from rpl_data.reconstruct.surface import fuse_surface
from rpl_data.types import ColorImage, Frame, Mesh, Trajectory

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
