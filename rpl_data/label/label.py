"""Label every frame from one object pose per scene: pose, keypoints, masks (paper III-E, Eq. 3).

``camera_from_object = invert(scene_from_camera) @ scene_from_object`` gives the object's pose
in every frame. From there keypoints are projected and masks are ray cast, inside the projected region only.
Occlusion is decided from the object's own mesh, the other objects' meshes and the measured depth. Frames are
independent of one another: ranges of them may be labelled in parallel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Int64

from rpl_data.geometry import Pixels, Transform, inside_image, square_box, transform
from rpl_data.label.alone import Body, ObjectAlone, SceneObject, object_alone
from rpl_data.label.certainty import quality, sigma_px
from rpl_data.label.frame_correction import Correction, FrameCorrector
from rpl_data.label.masks import box_of, encode, overlap, reaches_border
from rpl_data.label.motion import Motion
from rpl_data.label.occlusion import (
    FAR_M,
    DepthPatch,
    Tolerances,
    hidden_pixels,
    keypoints_seen,
)
from rpl_data.raycast import PixelTable
from rpl_data.types import (
    Box,
    DataError,
    DepthImage,
    Frame,
    FrameLabel,
    GreyImage,
    InstanceLabel,
    ReadDepth,
    Scene,
    SquareBox,
    Trajectory,
)


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
    read_grey: Callable[[Frame], GreyImage] | None = None,
    camera_from_object: Mapping[tuple[int, str, str], Transform] | None = None,
    corrector: FrameCorrector | None = None,
    tolerances: Tolerances | None = None,
) -> Iterator[FrameLabel]:
    """Label the given frames, one at a time, in constant memory.

    Args:
        scene: gives the camera and the name that the labels carry.
        objects: all labelled objects of the scene; each may hide the others.
        frames: which frames to label.
        read_depth: reads the depth image of a frame; not called for frames without one. Missing depth hides
            nothing.
        read_grey: reads the brightness of a frame, at full size; its edges then show, beside those of depth,
            how far off the label is.
        camera_from_object: refined poses by (frame index, object, instance); they replace those of Eq. 3.
        corrector: corrects the poses of single frames by what they show, where `read_grey` is given.
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
        scene,
        trajectory,
        objects,
        frames,
        read_depth,
        read_grey,
        camera_from_object or {},
        corrector,
        tolerances or Tolerances(),
    )


def _label_frames(
    scene: Scene,
    trajectory: Trajectory,
    objects: Sequence[SceneObject],
    frames: Iterable[Frame],
    read_depth: ReadDepth,
    read_grey: Callable[[Frame], GreyImage] | None,
    refined: Mapping[tuple[int, str, str], Transform],
    corrector: FrameCorrector | None,
    tolerances: Tolerances,
) -> Iterator[FrameLabel]:
    camera = PixelTable.of(scene.intrinsics)
    motion = Motion.of(scene, trajectory)
    bodies = [Body.of(item) for item in objects]
    for frame in frames:
        depth_m = None if frame.depth is None else read_depth(frame)
        objects_alone = []
        for body in bodies:
            eq3 = body.item.camera_from_object(trajectory, frame.index)
            alone = object_alone(camera, body, refined.get((frame.index, *body.item.key), eq3))
            if alone is not None:
                objects_alone.append(alone)
        grey = read_grey(frame) if read_grey is not None and objects_alone else None
        found: Sequence[Correction | None] = [None] * len(objects_alone)
        by_path = objects_alone
        if corrector is not None and grey is not None and depth_m is not None:
            others_m = [_nearest_other(alone, by_path) for alone in by_path]
            objects_alone, found = corrector.corrected(
                frame.index, by_path, others_m, depth_m, grey, tolerances
            )
        instances = tuple(
            _instance(
                camera,
                alone,
                objects_alone,
                depth_m,
                grey,
                tolerances,
                speed_px_s=motion.speed_px_s(camera, frame.index, alone.body.item),
                correction=correction,
                moved=alone is not before,
            )
            for alone, before, correction in zip(objects_alone, by_path, found, strict=True)
        )
        yield FrameLabel(scene.name, frame.index, frame.timestamp_s, instances)


# Occlusion ----------------------------------------------------------------------------------------


def _instance(
    camera: PixelTable,
    alone: ObjectAlone,
    objects_alone: Sequence[ObjectAlone],
    depth_m: DepthImage | None,
    grey: GreyImage | None,
    tolerances: Tolerances,
    *,
    speed_px_s: float,
    correction: Correction | None,
    moved: bool,
) -> InstanceLabel:
    measured = np.zeros_like(alone.depth_m) if depth_m is None else depth_m[alone.window]
    others = _nearest_other(alone, objects_alone)
    visible = alone.mask & ~hidden_pixels(alone.depth_m, others, measured, tolerances)
    visibility = _visibility(camera, alone, others, measured, tolerances)
    sigmas_px = sigma_px(
        camera,
        alone,
        visible,
        depth_m,
        grey,
        tolerances,
        speed_px_s=speed_px_s,
        by_print_px=None if correction is None else correction.moved_px,
    )
    box_full = box_of(alone.mask, alone.window)
    size = {"width": camera.intrinsics.width, "height": camera.intrinsics.height}
    return InstanceLabel(
        object=alone.body.item.model.name,
        camera_from_object=alone.camera_from_object,
        keypoints_px=alone.keypoints_px,
        visibility=visibility,
        sigma_px=np.where(visibility > 0, sigmas_px, np.nan),
        square_box=_square_box(alone.keypoints_px, box_full),
        box=box_of(visible, alone.window) if visible.any() else None,
        box_full=box_full,
        mask=encode(visible, alone.window, **size),
        mask_full=encode(alone.mask, alone.window, **size),
        visib_fract=float(visible.sum() / alone.mask.sum()),
        truncated=reaches_border(box_full, **size),
        quality=quality(sigmas_px),
        corrected_px=correction.moved_px if moved and correction is not None else None,
        instance=alone.body.item.instance,
    )


def _visibility(
    camera: PixelTable, alone: ObjectAlone, others: DepthPatch, measured: DepthPatch, tolerances: Tolerances
) -> Int64[np.ndarray, " k"]:
    """COCO's v per keypoint: 0 never clicked, behind the camera or outside the image; 1 hidden; 2 seen."""
    visibility = np.zeros(len(alone.keypoints_px), dtype=np.int64)
    inside = inside_image(camera.intrinsics, alone.keypoints_px)
    z_m = transform(alone.camera_from_object, alone.body.item.model.points_object)[inside, 2]
    body = alone.body
    seen = body.around.faces(body.rays, alone.camera_from_object)[inside]
    seen &= keypoints_seen(alone.keypoints_px[inside], z_m, alone.window, others, measured, tolerances)
    visibility[inside] = np.where(seen, 2, 1)
    return visibility


def _nearest_other(alone: ObjectAlone, objects_alone: Sequence[ObjectAlone]) -> DepthPatch:
    """Depth of the nearest other object in the window; FAR_M = none."""
    nearest = np.full_like(alone.depth_m, FAR_M)
    for other in objects_alone:
        common = overlap(alone.window, other.window)
        if other is not alone and common is not None:
            here, there = common
            nearest[here] = np.minimum(nearest[here], other.depth_m[there])
    return nearest


# Numbers of the label -----------------------------------------------------------------------------


def _square_box(keypoints_px: Pixels, box_full: Box) -> SquareBox:
    """The paper's square box around the keypoints; around the mask where no keypoint projects."""
    known = keypoints_px[np.isfinite(keypoints_px).all(axis=1)]
    if not len(known):
        known = np.array(box_full).reshape(2, 2) - 0.5
    return square_box(known)
