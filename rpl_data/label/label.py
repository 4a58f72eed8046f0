"""Label every frame from one object pose per scene: pose, keypoints, masks (paper III-E, Eq. 3).

``camera_from_object = invert(scene_from_camera) @ scene_from_object`` gives the object's pose
in every frame. From there keypoints are projected and masks are ray cast, inside the projected region only.
Occlusion is decided from the object's own mesh, the other objects' meshes and the measured depth. Frames are
independent of one another: ranges of them may be labelled in parallel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from rpl_data.geometry import Transform, transform
from rpl_data.label.alone import Body, ObjectAlone, SceneObject, object_alone
from rpl_data.label.certainty import quality, sigma_px
from rpl_data.label.frame_correction import Correction, FrameCorrector
from rpl_data.label.instance import instance_label, keypoint_visibility, nearest_other_m
from rpl_data.label.motion import Motion
from rpl_data.label.occlusion import DepthPatch, Tolerances, hidden_pixels
from rpl_data.label.outline import REACH_PX
from rpl_data.raycast import PixelTable
from rpl_data.types import (
    DataError,
    DepthImage,
    Frame,
    FrameLabel,
    GreyImage,
    InstanceLabel,
    ReadDepth,
    ReadDepthInto,
    Scene,
    Trajectory,
    Window,
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
    read_depth_into: ReadDepthInto | None = None,
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
        read_depth: reads the depth image of a frame; not called for frames without one, or in which no
            object is. Missing depth hides nothing.
        read_depth_into: reads only the part of it that labels look at, in place of `read_depth`.
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
            "wrong; write `registered: true` for it in the recipe if the camera aligned it, or the `mend:` "
            "that `rpl check` names, or record again with depth aligned to colour"
        )
    return _label_frames(
        scene,
        trajectory,
        objects,
        frames,
        _reader(scene, read_depth, read_depth_into),
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
    read_depth: Callable[[Frame, Window], DepthImage],
    read_grey: Callable[[Frame], GreyImage] | None,
    refined: Mapping[tuple[int, str, str], Transform],
    corrector: FrameCorrector | None,
    tolerances: Tolerances,
) -> Iterator[FrameLabel]:
    camera = PixelTable.of(scene.intrinsics)
    motion = Motion.of(scene, trajectory)
    bodies = [Body.of(item) for item in objects]
    speeds_px_s = {item.key: motion.speeds_px_s(camera, item) for item in objects}
    for frame in frames:
        objects_alone = []
        for body in bodies:
            eq3 = body.item.camera_from_object(trajectory, frame.index)
            alone = object_alone(camera, body, refined.get((frame.index, *body.item.key), eq3))
            if alone is not None:
                objects_alone.append(alone)
        grey = read_grey(frame) if read_grey is not None and objects_alone else None
        depth_m = None
        if frame.depth is not None and objects_alone:
            looked_at = _looked_at(scene, objects_alone)
            depth_m = read_depth(frame, looked_at)
        found: Sequence[Correction | None] = [None] * len(objects_alone)
        by_path = objects_alone
        if corrector is not None and grey is not None and depth_m is not None:
            others_m = [_nearest_other(alone, by_path) for alone in by_path]
            objects_alone, found = corrector.corrected(
                frame.index, by_path, others_m, depth_m, grey, tolerances
            )
            if not _within(_looked_at(scene, objects_alone), looked_at):
                depth_m = read_depth(frame, _looked_at(scene, objects_alone))
        instances = tuple(
            _instance(
                camera,
                alone,
                objects_alone,
                depth_m,
                grey,
                tolerances,
                speed_px_s=speeds_px_s[alone.body.item.key][frame.index],
                correction=correction,
                moved=alone is not before,
            )
            for alone, before, correction in zip(objects_alone, by_path, found, strict=True)
        )
        yield FrameLabel(scene.name, frame.index, frame.timestamp_s, instances)


def _reader(
    scene: Scene, read_depth: ReadDepth, read_depth_into: ReadDepthInto | None
) -> Callable[[Frame, Window], DepthImage]:
    """Reads depth images of which only a window will be looked at; each is valid until the next one."""
    if read_depth_into is None:
        return lambda frame, window: read_depth(frame)
    # One for all frames: to clear new memory takes as long as to read the window into it.
    image = np.zeros((scene.intrinsics.height, scene.intrinsics.width), np.float32)

    def read(frame: Frame, window: Window) -> DepthImage:
        read_depth_into(frame, window, image)
        return image

    return read


def _looked_at(scene: Scene, objects_alone: Sequence[ObjectAlone]) -> Window:
    """Rows and columns of a depth image in which any of the objects, or an edge near its outline, can be."""
    rows, columns = zip(*(alone.window for alone in objects_alone), strict=True)
    return _span(rows, scene.intrinsics.height), _span(columns, scene.intrinsics.width)


def _span(parts: Sequence[slice], size: int) -> slice:
    low, high = min(part.start for part in parts), max(part.stop for part in parts)
    return slice(max(low - REACH_PX, 0), min(high + REACH_PX, size))


def _within(inner: Window, outer: Window) -> bool:
    return all(a.start >= b.start and a.stop <= b.stop for a, b in zip(inner, outer, strict=True))


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
    item, pose = alone.body.item, alone.camera_from_object
    measured = np.zeros_like(alone.depth_m) if depth_m is None else depth_m[alone.window]
    others = _nearest_other(alone, objects_alone)
    visible = alone.mask & ~hidden_pixels(alone.depth_m, others, measured, tolerances)
    visibility = keypoint_visibility(
        camera.intrinsics,
        alone.body.around,
        alone.body.rays,
        pose,
        alone.keypoints_px,
        transform(pose, item.model.points_object)[:, 2],
        alone.window,
        others,
        measured,
        tolerances,
    )
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
    return instance_label(
        camera.intrinsics,
        name=item.model.name,
        camera_from_object=pose,
        keypoints_px=alone.keypoints_px,
        visibility=visibility,
        sigma_px=sigmas_px,
        window=alone.window,
        mask=alone.mask,
        visible=visible,
        quality=quality(sigmas_px),
        corrected_px=correction.moved_px if moved and correction is not None else None,
        instance=item.instance,
    )


def _nearest_other(alone: ObjectAlone, objects_alone: Sequence[ObjectAlone]) -> DepthPatch:
    """Depth of the nearest other object in the window; FAR_M = none."""
    return nearest_other_m(
        alone.window, [(other.window, other.depth_m) for other in objects_alone if other is not alone]
    )
