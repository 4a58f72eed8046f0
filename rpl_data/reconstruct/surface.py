"""Fuse depth images to the surface near the object, in the scene frame (paper III-A)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import NEAREST_M, Sphere, cropped, invert, project, transform
from rpl_data.reconstruct.fused_frames import MOST_FRAMES, frames_to_fuse, steady_frames
from rpl_data.reconstruct.tsdf import empty_grid, extract, integrate
from rpl_data.types import (
    ColorImage,
    DataError,
    DepthImage,
    Frame,
    Intrinsics,
    Mesh,
    ReadDepth,
    Scene,
    Trajectory,
)


def fuse_surface(
    scene: Scene,
    trajectory: Trajectory,
    frames: Iterable[Frame],
    depths: ReadDepth,
    *,
    centre_scene: Float64[np.ndarray, "3"],
    radius_m: float,
    voxel_m: float = 0.003,
    colors: Callable[[Frame], ColorImage] | None = None,
    most_frames: int = MOST_FRAMES,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> Mesh:
    """Fuse depth images to the surface inside one sphere; see `fuse_surfaces`."""
    sphere = Sphere(centre_scene, radius_m)
    [mesh] = fuse_surfaces(
        scene,
        trajectory,
        frames,
        depths,
        spheres=[sphere],
        voxel_m=voxel_m,
        colors=colors,
        most_frames=most_frames,
        advance=advance,
    )
    return mesh


def fuse_surfaces(
    scene: Scene,
    trajectory: Trajectory,
    frames: Iterable[Frame],
    depths: ReadDepth,
    *,
    spheres: Sequence[Sphere],
    voxel_m: float = 0.003,
    colors: Callable[[Frame], ColorImage] | None = None,
    most_frames: int = MOST_FRAMES,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> list[Mesh]:
    """Fuse depth images to the surface inside each sphere, by a TSDF; each image is read once.

    Only depth inside the spheres is integrated: a whole room at 3 mm would take seconds per frame. A sphere
    should hold the object and some of its support, so that the support can be recognised; twice the extent of
    the keypoints is a good diameter.

    Args:
        frames: frames to fuse. Those that move too fast or do not see a sphere are skipped unread.
        depths: reads the depth image of a frame.
        spheres: in the scene frame.
        colors: reads the colour image of a frame; called for the fused frames only.
        most_frames: of more than this, those are fused that show the spheres from all sides
            (`frames_to_fuse`), so that the cost does not grow with the length of the recording.
        advance: receives how many of the chosen frames are done, and their number.

    Returns:
        A mesh per sphere in the scene frame, counter-clockwise from outside, coloured when `colors` is given.

    Raises:
        DataError: no depth lies inside a sphere.
    """
    ideal = replace(scene.intrinsics, distortion=())
    steady = [steady_frames(scene, trajectory, centre_scene=sphere.centre_m) for sphere in spheres]
    regions = [_Region(sphere, empty_grid(voxel_m, colored=colors is not None)) for sphere in spheres]
    seeing: dict[Frame, list[tuple[_Region, _View]]] = {}
    for frame in frames:
        views = [
            (region, view)
            for region, kept in zip(regions, steady, strict=True)
            if frame.index in kept and (view := _view_of(ideal, trajectory.at(frame.index), region.sphere))
        ]
        if views:
            seeing[frame] = views
    centres = np.array([sphere.centre_m for sphere in spheres])
    chosen = frames_to_fuse(scene, trajectory, list(seeing), centres_scene=centres, most=most_frames)
    for number, frame in enumerate(chosen):
        advance(number, len(chosen))
        _fuse_frame(scene, frame, seeing[frame], depths, colors)
    return [_extracted(region, scene) for region in regions]


@dataclass
class _Region:
    """A sphere, the grid of its surface, and how many frames were fused to it."""

    sphere: Sphere
    grid: Any
    fused: int = 0


@dataclass(frozen=True)
class _View:
    """The part of an image that can show a sphere."""

    window: tuple[slice, slice]
    camera: Intrinsics
    camera_from_scene: Float64[np.ndarray, "4 4"]
    centre_camera: Float64[np.ndarray, "3"]


def _view_of(
    intrinsics: Intrinsics, scene_from_camera: Float64[np.ndarray, "4 4"], sphere: Sphere
) -> _View | None:
    """The part of an image that can show a sphere; None when none can."""
    camera_from_scene = invert(scene_from_camera)
    centre_camera = transform(camera_from_scene, sphere.centre_m)
    rectangle = _rectangle_around(intrinsics, centre_camera, sphere.radius_m)
    if rectangle is None:
        return None
    left, top, right, bottom = rectangle
    camera = cropped(intrinsics, left_px=left, top_px=top, width=right - left, height=bottom - top)
    return _View((slice(top, bottom), slice(left, right)), camera, camera_from_scene, centre_camera)


def _fuse_frame(
    scene: Scene,
    frame: Frame,
    views: Sequence[tuple[_Region, _View]],
    depths: ReadDepth,
    colors: Callable[[Frame], ColorImage] | None,
) -> None:
    """Add a frame to the grids of the spheres in which it shows something."""
    depth_m = depths(frame)
    if scene.intrinsics.distortion:
        depth_m = _undistorted(depth_m, scene.intrinsics, cv2.INTER_NEAREST)
    color = None
    for region, view in views:
        near_m = without_flying_pixels(depth_m[view.window])
        near_m = _only_in_sphere(near_m, view.camera, view.centre_camera, region.sphere.radius_m)
        if not near_m.any():
            continue
        if colors is not None and color is None:
            color = colors(frame)
            if scene.intrinsics.distortion:
                color = _undistorted(color, scene.intrinsics, cv2.INTER_LINEAR)
        part = None if color is None else color[view.window]
        integrate(region.grid, near_m, part, view.camera, view.camera_from_scene)
        region.fused += 1


def _extracted(region: _Region, scene: Scene) -> Mesh:
    """The surface of a region; DataError where there is none."""
    if region.fused:
        # A voxel seen once in a long recording is noise; in a recording of a few frames it is all we have.
        mesh = extract(region.grid, weight_threshold=min(3.0, region.fused / 4))
        if len(mesh.triangles) and np.isfinite(mesh.vertices).all():
            return mesh
    raise _nothing(scene, region.sphere.centre_m, region.sphere.radius_m)


def without_flying_pixels(depth_m: DepthImage, *, max_step: float = 0.03) -> DepthImage:
    """Remove the pixels at jumps of depth, where sensors mix front and back.

    Args:
        max_step: share of the depth by which neighbours may differ; 3 % per pixel is a surface seen at 87
            degrees from its normal with a focal length of 600 px.
    """
    far = cv2.dilate(depth_m, np.ones((3, 3), np.uint8))
    near = cv2.erode(np.where(depth_m > 0, depth_m, np.float32(np.inf)), np.ones((3, 3), np.uint8))
    kept: DepthImage = np.where(far - near <= max_step * depth_m, depth_m, np.float32(0))
    return kept


def _rectangle_around(
    intrinsics: Intrinsics, centre_camera: Float64[np.ndarray, "3"], radius_m: float
) -> tuple[int, int, int, int] | None:
    """The rectangle of pixels (left, top, right, bottom) that can see the sphere; None when none can."""
    corners = centre_camera + radius_m * np.array(
        [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float
    )
    if corners[:, 2].max() < NEAREST_M:
        return None
    if corners[:, 2].min() < NEAREST_M:  # the camera may be inside: look everywhere
        return 0, 0, intrinsics.width, intrinsics.height
    uv = project(intrinsics, corners)
    left, top = np.maximum(np.floor(uv.min(axis=0)).astype(int), 0)
    right, bottom = np.minimum(np.ceil(uv.max(axis=0)).astype(int) + 1, [intrinsics.width, intrinsics.height])
    return (int(left), int(top), int(right), int(bottom)) if left < right and top < bottom else None


def _only_in_sphere(
    depth_m: DepthImage, view: Intrinsics, centre_camera: Float64[np.ndarray, "3"], radius_m: float
) -> DepthImage:
    """The depth image with everything outside the sphere set to 0 (none); the view has no lens distortion."""
    x = ((np.arange(view.width) - view.cx) / view.fx).astype(np.float32)
    y = ((np.arange(view.height) - view.cy) / view.fy).astype(np.float32)[:, None]
    cx, cy, cz = centre_camera.astype(np.float32)
    # |z (x, y, 1) - c|^2 = z (z (x^2 + y^2 + 1) - 2 (x, y, 1) . c) + |c|^2
    squared_m2 = depth_m * (x**2 + (y**2 + 1))
    squared_m2 -= 2 * cx * x + 2 * (cy * y + cz)
    squared_m2 *= depth_m
    inside = squared_m2 < np.float32(radius_m**2 - (centre_camera**2).sum())
    return np.where(inside & (depth_m > 0), depth_m, np.float32(0))


def _undistorted(image: Any, intrinsics: Intrinsics, interpolation: int) -> Any:
    """The image that a camera without lens distortion would have taken."""
    return cv2.remap(image, *_undistorting_maps(intrinsics), interpolation)


@lru_cache(maxsize=1)
def _undistorting_maps(intrinsics: Intrinsics) -> tuple[Any, Any]:
    """For each pixel without lens distortion, where it lies in the image."""
    maps: tuple[Any, Any] = cv2.initUndistortRectifyMap(
        intrinsics.matrix,
        np.array(intrinsics.distortion),
        None,
        intrinsics.matrix,
        (intrinsics.width, intrinsics.height),
        cv2.CV_32FC1,
    )
    return maps


def _nothing(scene: Scene, centre_scene: Float64[np.ndarray, "3"], radius_m: float) -> DataError:
    return DataError(
        f"scene {scene.name}: no depth within {radius_m:.2f} m of {np.round(centre_scene, 3).tolist()} "
        "(scene frame), where the keypoints say the object is; expected a surface there; check the "
        "clicks of this scene, its trajectory and its depth scale"
    )
