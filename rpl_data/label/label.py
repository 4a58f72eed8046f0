"""Label every frame from one object pose per scene: pose, keypoints, masks (paper III-E, Eq. 3).

``camera_from_object = invert(scene_from_camera) @ scene_from_object`` gives the object's pose
in every frame. From there keypoints are projected and masks are ray cast, inside the projected region only.
Occlusion is decided from the object's own mesh, the other objects' meshes and the measured depth. Frames are
independent of one another: ranges of them may be labelled in parallel.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.geometry import Pixels, Points, Transform, inside_image, invert, square_box, transform
from rpl_data.label.masks import MaskPatch, Window, box_of, cleaned, encode, overlap, reaches_border
from rpl_data.label.occlusion import (
    FAR_M,
    DepthPatch,
    KeypointSurface,
    Tolerances,
    depth_agreement,
    hidden_pixels,
    keypoints_seen,
)
from rpl_data.raycast import PixelTable, RayScene, depth_along_m
from rpl_data.types import (
    Box,
    DataError,
    DepthImage,
    Frame,
    FrameLabel,
    InstanceLabel,
    Intrinsics,
    KeypointModel,
    Mesh,
    ReadDepth,
    Scene,
    SquareBox,
    Trajectory,
)

MARGIN_PX = 3
"""Margin around the projected region, for filters that look at neighbouring pixels."""


@dataclass(frozen=True)
class SceneObject:
    """An object and its pose in one scene.

    Attributes:
        model: the sparse model.
        covariance: One 3x3 covariance per keypoint, in m^2, in the object frame. It is that of the
            keypoint's position in the scene (shape and pose together); NaN where never clicked.
        mesh: the dense model, in the object frame.
    """

    model: KeypointModel
    covariance: Float64[np.ndarray, "k 3 3"]
    mesh: Mesh
    scene_from_object: Transform


def sample_frames(frames: Sequence[Frame], *, rate_hz: float | None) -> list[Frame]:
    """Choose the frames to label: the first of every period by timestamp; all of them for None.

    Raises:
        DataError: the rate is not positive.
    """
    if rate_hz is None:
        return list(frames)
    if not rate_hz > 0:
        raise DataError(f"the label rate is {rate_hz} Hz; expected a positive number, or `all`")
    chosen: list[Frame] = []
    last_period = -1
    for frame in frames:
        # 5 % of a period absorbs the jitter of timestamps without letting the schedule drift.
        period = int((frame.timestamp_s - frames[0].timestamp_s) * rate_hz + 0.05)
        if period > last_period:
            chosen.append(frame)
            last_period = period
    return chosen


def label_frames(
    scene: Scene,
    trajectory: Trajectory,
    objects: Sequence[SceneObject],
    frames: Iterable[Frame],
    read_depth: ReadDepth,
    *,
    camera_from_object: Mapping[tuple[int, str], Transform] | None = None,
    tolerances: Tolerances | None = None,
) -> Iterator[FrameLabel]:
    """Label the given frames, one at a time, in constant memory.

    Args:
        scene: gives the camera and the name that the labels carry.
        objects: all labelled objects of the scene; each may hide the others.
        frames: which frames to label.
        read_depth: reads the depth image of a frame; not called for frames without one. Missing depth hides
            nothing.
        camera_from_object: refined poses by (frame index, object name); they replace those of Eq. 3.
        tolerances: by how much surfaces must differ in depth for one to hide the other.

    Raises:
        DataError: depth and colour are not registered, a mesh has no triangles, or the trajectory
            has no pose for a frame.
    """
    if not scene.registered:
        raise DataError(
            f"scene {scene.name}: depth is not registered to colour, so masks and visibility would be "
            "wrong; align depth to colour when recording, or warp the depth images to it first"
        )
    return _label_frames(
        scene, trajectory, objects, frames, read_depth, camera_from_object or {}, tolerances or Tolerances()
    )


def _label_frames(
    scene: Scene,
    trajectory: Trajectory,
    objects: Sequence[SceneObject],
    frames: Iterable[Frame],
    read_depth: ReadDepth,
    refined: Mapping[tuple[int, str], Transform],
    tolerances: Tolerances,
) -> Iterator[FrameLabel]:
    camera = PixelTable.of(scene.intrinsics)
    bodies = [_Body.of(item) for item in objects]
    for frame in frames:
        depth_m = None if frame.depth is None else read_depth(frame)
        camera_from_scene = invert(trajectory.at(frame.index))
        objects_alone = []
        for body in bodies:
            eq3 = camera_from_scene @ body.item.scene_from_object
            alone = _object_alone(camera, body, refined.get((frame.index, body.item.model.name), eq3))
            if alone is not None:
                objects_alone.append(alone)
        instances = tuple(
            _instance(camera, alone, objects_alone, depth_m, tolerances) for alone in objects_alone
        )
        yield FrameLabel(scene.name, frame.index, frame.timestamp_s, instances)


@dataclass(frozen=True)
class _Body:
    """An object prepared for ray casting.

    Attributes:
        rays: its mesh.
        hull: vertices of its convex hull, in the object frame.
        around: its surface around the keypoints.
    """

    item: SceneObject
    rays: RayScene
    hull: Points
    around: KeypointSurface

    @staticmethod
    def of(item: SceneObject) -> _Body:
        from scipy.spatial import ConvexHull

        rays = RayScene([item.mesh], threads=1)
        corners = ConvexHull(item.mesh.vertices, qhull_options="QJ").vertices  # QJ: flat meshes too
        around = KeypointSurface.around(rays, item.model.points_object)
        return _Body(item, rays, item.mesh.vertices[corners], around)


# One object in one frame, without occluders -------------------------------------------------------


@dataclass(frozen=True)
class _ObjectAlone:
    """One object rendered without occluders, in the window of the image that holds it.

    Attributes:
        window: rows and columns of the image.
        depth_m: depth of the mesh in the window; FAR_M where the mesh is not.
        mask: pixels of the window that the object covers.
    """

    body: _Body
    camera_from_object: Transform
    keypoints_px: Pixels
    window: Window
    depth_m: DepthPatch
    mask: MaskPatch


def _object_alone(camera: PixelTable, body: _Body, camera_from_object: Transform) -> _ObjectAlone | None:
    """Render one object without occluders; None when it covers no pixel.

    Its depth, mask and projected keypoints are computed in the window of the image that holds it.
    """
    keypoints_px = camera.project(transform(camera_from_object, body.item.model.points_object))
    window = _window(camera, transform(camera_from_object, body.hull), keypoints_px)
    if window is None:
        return None
    depth_m = depth_along_m(body.rays, camera.directions[window], camera_from_object)
    depth_m[depth_m == 0] = FAR_M
    # Pin-holes of a fused mesh are closed; the hole of a handle is wider and stays.
    mask = cleaned(depth_m < FAR_M, "close", size_px=3)
    if not mask.any():
        return None
    return _ObjectAlone(body, camera_from_object, keypoints_px, window, depth_m, mask)


def _window(
    camera: PixelTable, hull_camera: Points, keypoints_px: Float64[np.ndarray, "k 2"]
) -> Window | None:
    """Part of the image that holds the object, its keypoints and a margin; None when out of view."""
    window = camera.window(hull_camera)
    if window is None:
        return None
    shown = np.rint(keypoints_px[inside_image(camera.intrinsics, keypoints_px)]).astype(int)
    height, width = camera.intrinsics.height, camera.intrinsics.width
    return _widened(window[0], shown[:, 1], height), _widened(window[1], shown[:, 0], width)


def _widened(span: slice, numbers: Int64[np.ndarray, " n"], size: int) -> slice:
    """The span extended to those numbers and by the margin, limited to 0..size."""
    low = min(span.start, numbers.min(initial=size)) - MARGIN_PX
    high = max(span.stop, numbers.max(initial=-1) + 1) + MARGIN_PX
    return slice(max(int(low), 0), min(int(high), size))


# Occlusion ----------------------------------------------------------------------------------------


def _instance(
    camera: PixelTable,
    alone: _ObjectAlone,
    objects_alone: Sequence[_ObjectAlone],
    depth_m: DepthImage | None,
    tolerances: Tolerances,
) -> InstanceLabel:
    measured = np.zeros_like(alone.depth_m) if depth_m is None else depth_m[alone.window]
    others = _nearest_other(alone, objects_alone)
    visible = alone.mask & ~hidden_pixels(alone.depth_m, others, measured, tolerances)
    visibility = _visibility(camera, alone, others, measured, tolerances)
    sigma_px = _sigma_px(camera.intrinsics, alone.body.item, alone.camera_from_object)
    box_full = box_of(alone.mask, alone.window)
    size = {"width": camera.intrinsics.width, "height": camera.intrinsics.height}
    return InstanceLabel(
        object=alone.body.item.model.name,
        camera_from_object=alone.camera_from_object,
        keypoints_px=alone.keypoints_px,
        visibility=visibility,
        sigma_px=np.where(visibility > 0, sigma_px, np.nan),
        square_box=_square_box(alone.keypoints_px, box_full),
        box=box_of(visible, alone.window) if visible.any() else None,
        box_full=box_full,
        mask=encode(visible, alone.window, **size),
        mask_full=encode(alone.mask, alone.window, **size),
        visib_fract=float(visible.sum() / alone.mask.sum()),
        truncated=reaches_border(box_full, **size),
        quality=depth_agreement(alone.depth_m, visible, measured, tolerances),
    )


def _visibility(
    camera: PixelTable, alone: _ObjectAlone, others: DepthPatch, measured: DepthPatch, tolerances: Tolerances
) -> Int64[np.ndarray, " k"]:
    """COCO's v per keypoint: 0 never clicked, behind the camera or outside the image; 1 hidden; 2 seen."""
    visibility = np.zeros(len(alone.keypoints_px), dtype=np.int64)
    inside = inside_image(camera.intrinsics, alone.keypoints_px)
    z_m = transform(alone.camera_from_object, alone.body.item.model.points_object)[inside, 2]
    body = alone.body
    seen = body.around.faces(body.rays, alone.camera_from_object, keypoints=len(inside))[inside]
    seen &= keypoints_seen(alone.keypoints_px[inside], z_m, alone.window, others, measured, tolerances)
    visibility[inside] = np.where(seen, 2, 1)
    return visibility


def _nearest_other(alone: _ObjectAlone, objects_alone: Sequence[_ObjectAlone]) -> DepthPatch:
    """Depth of the nearest other object in the window; FAR_M = none."""
    nearest = np.full_like(alone.depth_m, FAR_M)
    for other in objects_alone:
        common = overlap(alone.window, other.window)
        if other is not alone and common is not None:
            here, there = common
            nearest[here] = np.minimum(nearest[here], other.depth_m[there])
    return nearest


# Numbers of the label -----------------------------------------------------------------------------


def _sigma_px(
    intrinsics: Intrinsics, item: SceneObject, camera_from_object: Transform
) -> Float64[np.ndarray, " k"]:
    """Standard deviation of each projected keypoint per axis (root mean square of u and v).

    The covariance is propagated to first order through the pinhole projection. Lens distortion is ignored; it
    changes the result by a few per cent at most.
    """
    x, y, z = transform(camera_from_object, item.model.points_object).T
    zero = np.zeros_like(x)
    with np.errstate(divide="ignore", invalid="ignore"):  # keypoints in the camera's plane are not labelled
        du = np.array([intrinsics.fx / z, zero, -intrinsics.fx * x / z**2])
        dv = np.array([zero, intrinsics.fy / z, -intrinsics.fy * y / z**2])
        derivative = np.array([du, dv]).transpose(2, 0, 1) @ camera_from_object[:3, :3]
        variance = np.einsum("kij,kjl,kil->k", derivative, item.covariance, derivative)
        sigma: Float64[np.ndarray, " k"] = np.sqrt(variance / 2)
    return sigma


def _square_box(keypoints_px: Pixels, box_full: Box) -> SquareBox:
    """The paper's square box around the keypoints; around the mask where no keypoint projects."""
    known = keypoints_px[np.isfinite(keypoints_px).all(axis=1)]
    if not len(known):
        known = np.array(box_full).reshape(2, 2) - 0.5
    return square_box(known)
