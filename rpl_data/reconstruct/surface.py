"""Fuse depth images to the surface near the object, in the scene frame (paper III-A)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import NEAREST_M, cropped, invert, project, rays, transform
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

BLOCK_VOXELS = 8  # 8^3 blocks cost half of Open3D's default 16^3 here: fewer voxels far from the surface
TRUNCATION_VOXELS = 2.0
"""Truncation distance of the TSDF, in voxels. The two sides of a wall thinner than this share voxels, so it
comes out too thick."""


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
) -> Mesh:
    """Fuse depth images to the surface inside a sphere, by a TSDF.

    Only depth inside the sphere is integrated: a whole room at 3 mm would take seconds per frame. The sphere
    should hold the object and some of its support, so that the support can be recognised; twice the extent of
    the keypoints is a good diameter.

    Args:
        frames: frames to fuse; those that move too fast or do not see the sphere are skipped unread.
        depths: reads the depth image of a frame.
        centre_scene: centre of the sphere, scene frame.
        colors: reads the colour image of a frame; called for the fused frames only.

    Returns:
        A mesh in the scene frame, counter-clockwise from outside, coloured when `colors` is given.

    Raises:
        DataError: no depth lies inside the sphere.
    """
    grid = _empty_grid(voxel_m, colored=colors is not None)
    fused = 0
    steady = steady_frames(scene, trajectory, centre_scene=centre_scene)
    for frame in frames:
        if frame.index not in steady:
            continue
        camera_from_scene = invert(trajectory.at(frame.index))
        color = None
        intrinsics = replace(scene.intrinsics, distortion=())
        centre_camera = transform(camera_from_scene, centre_scene)
        rectangle = _rectangle_around(intrinsics, centre_camera, radius_m)
        if rectangle is None:
            continue
        depth_m = depths(frame)
        if scene.intrinsics.distortion:
            depth_m, _ = _undistorted(depth_m, scene.intrinsics, cv2.INTER_NEAREST)
        window = (slice(rectangle[1], rectangle[3]), slice(rectangle[0], rectangle[2]))
        view = cropped(
            intrinsics,
            left_px=rectangle[0],
            top_px=rectangle[1],
            width=rectangle[2] - rectangle[0],
            height=rectangle[3] - rectangle[1],
        )
        near_m = _only_in_sphere(without_flying_pixels(depth_m[window]), view, centre_camera, radius_m)
        if not near_m.any():
            continue
        if colors is not None:
            color = colors(frame)
            if scene.intrinsics.distortion:
                color, _ = _undistorted(color, scene.intrinsics, cv2.INTER_LINEAR)
            color = color[window]
        _integrate(grid, near_m, color, view, camera_from_scene)
        fused += 1
    if not fused:
        raise _nothing(scene, centre_scene, radius_m)
    # A voxel seen once in a long recording is noise; in a recording of a few frames it is all we have.
    mesh = _extract(grid, weight_threshold=min(3.0, fused / 4))
    if not len(mesh.triangles) or not np.isfinite(mesh.vertices).all():
        raise _nothing(scene, centre_scene, radius_m)
    return mesh


def steady_frames(
    scene: Scene,
    trajectory: Trajectory,
    *,
    centre_scene: Float64[np.ndarray, "3"],
    same_view_rad: float = 0.17,
    excess: float = 1.5,
    still_px: float = 1.0,
) -> set[int]:
    """Choose the frames worth fusing: fast ones only where no slower one saw the same side.

    While a hand-held camera moves fast, rolling shutter and the lag between colour and depth make its pose
    wrong by up to the image motion per frame (25 px on a real recording, 2 px in its slow frames). One such
    frame blurs the surface.

    Args:
        same_view_rad: frames whose directions to the centre differ by less than this see the same side.
        excess: a frame may move this many times faster than the slowest frame of the same side.
        still_px: frames with less image motion than this are always used.

    Returns:
        Their `Frame.index`.
    """
    camera_from_scene = invert(trajectory.scene_from_camera)
    if len(camera_from_scene) < 3:
        return set(trajectory.frames.tolist())
    cube = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    uv = np.array([project(scene.intrinsics, transform(t, centre_scene + cube)) for t in camera_from_scene])
    step_px = np.nan_to_num(np.linalg.norm(np.diff(uv, axis=0), axis=2), nan=np.inf).max(axis=1)
    step_px = step_px / np.maximum(np.diff(trajectory.frames), 1)
    motion_px = np.maximum(np.r_[step_px[0], step_px], np.r_[step_px, step_px[-1]])
    views = trajectory.scene_from_camera[:, :3, 3] - centre_scene
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    slowest_px = np.concatenate(  # not all at once: a table of all pairs would grow with the square
        [
            np.where(part @ views.T > np.cos(same_view_rad), motion_px, np.inf).min(axis=1)
            for part in np.array_split(views, len(views) // 500 + 1)
        ]
    )
    kept = motion_px <= np.maximum(excess * slowest_px, still_px)
    return set(trajectory.frames[kept].tolist())


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
    """The depth image with everything outside the sphere set to 0 (none)."""
    v, u = np.nonzero(np.abs(depth_m - centre_camera[2]) < radius_m)
    points = rays(view, np.column_stack([u, v]).astype(float)) * depth_m[v, u, None]
    inside = ((points - centre_camera) ** 2).sum(axis=1) < radius_m**2
    masked = np.zeros_like(depth_m)
    masked[v[inside], u[inside]] = depth_m[v[inside], u[inside]]
    return masked


def _undistorted(image: Any, intrinsics: Intrinsics, interpolation: int) -> tuple[Any, Intrinsics]:
    """The image that a camera without lens distortion would have taken, and that camera."""
    map_u, map_v = cv2.initUndistortRectifyMap(
        intrinsics.matrix,
        np.array(intrinsics.distortion),
        None,
        intrinsics.matrix,
        (intrinsics.width, intrinsics.height),
        cv2.CV_32FC1,
    )
    return cv2.remap(image, map_u, map_v, interpolation), replace(intrinsics, distortion=())


def _empty_grid(voxel_m: float, *, colored: bool) -> Any:
    import open3d as o3d

    names, dtypes, channels = ["tsdf", "weight"], [o3d.core.float32] * 2, [(1,), (1,)]
    if colored:
        names, dtypes, channels = [*names, "color"], [*dtypes, o3d.core.float32], [*channels, (3,)]
    # The tensor grid: Open3D 0.20's legacy ScalableTSDFVolume returns an empty mesh without a word.
    return o3d.t.geometry.VoxelBlockGrid(
        attr_names=tuple(names),
        attr_dtypes=tuple(dtypes),
        attr_channels=tuple(channels),
        voxel_size=voxel_m,
        block_resolution=BLOCK_VOXELS,
        block_count=4000,
        device=o3d.core.Device("CPU:0"),
    )


def _integrate(
    grid: Any,
    depth_m: DepthImage,
    color: ColorImage | None,
    view: Intrinsics,
    camera_from_scene: Float64[np.ndarray, "4 4"],
) -> None:
    """Add one depth image to the grid."""
    import open3d as o3d

    # Open3D truncates projected positions to a pixel; with our pixel centres at whole numbers the
    # nearest pixel is floor(u + 0.5), hence the half pixel on the principal point.
    matrix = view.matrix
    matrix[:2, 2] += 0.5
    intrinsic, extrinsic = o3d.core.Tensor(matrix), o3d.core.Tensor(camera_from_scene)
    depth = o3d.t.geometry.Image(np.ascontiguousarray(depth_m, dtype=np.float32))
    limit_m = float(depth_m.max()) + 0.01
    blocks = grid.compute_unique_block_coordinates(
        depth, intrinsic, extrinsic, 1.0, limit_m, trunc_voxel_multiplier=TRUNCATION_VOXELS
    )
    if color is None:
        grid.integrate(blocks, depth, intrinsic, extrinsic, 1.0, limit_m, TRUNCATION_VOXELS)
    else:
        # Open3D takes float colours from 0 to 1, and gives back the same.
        image = o3d.t.geometry.Image(np.ascontiguousarray(color, dtype=np.float32) / 255.0)
        grid.integrate(blocks, depth, image, intrinsic, extrinsic, 1.0, limit_m, TRUNCATION_VOXELS)


def _extract(grid: Any, *, weight_threshold: float) -> Mesh:
    extracted = grid.extract_triangle_mesh(weight_threshold=weight_threshold)
    vertices = extracted.vertex.positions.numpy().astype(np.float64)
    triangles = extracted.triangle.indices.numpy().astype(np.int64)
    colors = None
    if "colors" in extracted.vertex:
        scaled = extracted.vertex.colors.numpy()  # 0..1
        colors = np.clip(np.round(scaled * 255), 0, 255).astype(np.uint8)
    return Mesh(vertices, triangles, colors)


def _nothing(scene: Scene, centre_scene: Float64[np.ndarray, "3"], radius_m: float) -> DataError:
    return DataError(
        f"scene {scene.name}: no depth within {radius_m:.2f} m of {np.round(centre_scene, 3).tolist()} "
        "(scene frame), where the keypoints say the object is; expected a surface there; check the "
        "clicks of this scene, its trajectory and its depth scale"
    )
