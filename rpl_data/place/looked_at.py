"""What the cameras of a scene look at: the surface that a known object is searched on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rpl_data.geometry import Points, back_project, invert, transform
from rpl_data.meshes import oriented_points, smoothed_normals, thinned
from rpl_data.reconstruct.surface import fuse_surface
from rpl_data.segment.free_space import DepthView
from rpl_data.types import ColorImage, DataError, Frame, PointCloud, ReadDepth, Scene, Trajectory

FUSED_FRAMES, VIEWS = 24, 8
"""Frames that are fused, and depth images that show where space is free; spread over the scene."""
RADIUS_M = 0.35
VOXEL_M = 0.003
SPACING_M = 0.003
FARTHEST_M = 2.0
"""Depth beyond this is the room."""


@dataclass(frozen=True)
class LookedAt:
    """The middle of a scene, scene frame.

    Attributes:
        surface: points within `RADIUS_M` of the middle.
        cameras: centres of the cameras.
        views: some depth images, in the scene's frame.
    """

    surface: PointCloud
    cameras: Points
    views: tuple[DepthView, ...]


def looked_at(
    scene: Scene,
    trajectory: Trajectory,
    frames: Sequence[Frame],
    depths: ReadDepth,
    colors: Callable[[Frame], ColorImage],
    *,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> LookedAt:
    """Fuse what the cameras look at.

    Args:
        frames: those with a pose and a depth image.
        advance: receives how many of the fused frames are done.
    """
    chosen = frames[:: -(-len(frames) // FUSED_FRAMES)]
    seen = frames[:: -(-len(frames) // VIEWS)]
    views = [
        DepthView(scene.name, scene.intrinsics, invert(trajectory.at(frame.index)), depths(frame))
        for frame in seen
    ]
    near = np.concatenate([_middle_points(view) for view in views])
    if not len(near):
        raise DataError(
            f"scene {scene.name}: the middle of its images shows nothing nearer than {FARTHEST_M:g} m; click "
            "three keypoints of the object there, and register it without `--auto`"
        )
    middle = np.median(near, axis=0)

    mesh = fuse_surface(
        scene,
        trajectory,
        chosen,
        depths,
        centre_scene=middle,
        radius_m=RADIUS_M,
        voxel_m=VOXEL_M,
        colors=colors,
        advance=advance,
    )
    surface = smoothed_normals(thinned(oriented_points(mesh), voxel_m=SPACING_M), radius_m=2 * VOXEL_M)
    return LookedAt(surface, trajectory.scene_from_camera[:, :3, 3], tuple(views))


def _middle_points(view: DepthView) -> Points:
    """Points in the middle half of a depth image, scene frame."""
    height, width = view.depth_m.shape
    v, u = np.mgrid[height // 4 : 3 * height // 4 : 12, width // 4 : 3 * width // 4 : 12]
    depth = view.depth_m[v, u]
    near = (depth > 0) & (depth < FARTHEST_M)
    pixels = np.column_stack([u[near], v[near]]).astype(float)
    points = back_project(view.intrinsics, pixels, depth[near].astype(float))
    scene_points: Points = transform(invert(view.camera_from_object), points)
    return scene_points
