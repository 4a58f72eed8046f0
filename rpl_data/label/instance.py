"""Put a label together, of an object in a recorded or in a rendered image: its numbers, boxes and masks."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float32, Float64, Int64

from rpl_data.geometry import Pixels, Transform, inside_image, square_box
from rpl_data.keypoint_surface import KeypointSurface
from rpl_data.label.masks import MaskPatch, overlap, reaches_border
from rpl_data.label.occlusion import FAR_M, DepthPatch, Tolerances, keypoints_seen
from rpl_data.raycast import RayScene
from rpl_data.types import Box, InstanceLabel, Intrinsics, SquareBox, Window

OtherPatch = Float32[np.ndarray, "_ _"]
"""Depth in a window of another shape."""


def instance_label(
    camera: Intrinsics,
    *,
    name: str,
    camera_from_object: Transform,
    keypoints_px: Pixels,
    visibility: Int64[np.ndarray, " k"],
    sigma_px: Float64[np.ndarray, " k"],
    window: Window,
    mask: MaskPatch,
    visible: MaskPatch,
    quality: float,
    corrected_px: float | None = None,
    instance: str = "",
) -> InstanceLabel:
    """The label of an object in an image.

    Args:
        sigma_px: of each keypoint, also of those that are not labelled.
        mask: pixels of the window that the object would cover if nothing hid it; at least one.
        visible: those that nothing hides.
    """
    from rpl_data.label.compiled_masks import encoded

    size = {"width": camera.width, "height": camera.height}
    full, seen = encoded(mask, window, **size), encoded(visible, window, **size)
    if full.box is None:
        raise ValueError(f"{name}: a label needs a mask with at least one pixel")
    return InstanceLabel(
        object=name,
        camera_from_object=camera_from_object,
        keypoints_px=keypoints_px,
        visibility=visibility,
        sigma_px=np.where(visibility > 0, sigma_px, np.nan),
        square_box=square_around(keypoints_px, full.box),
        box=seen.box,
        box_full=full.box,
        mask=seen.rle,
        mask_full=full.rle,
        visib_fract=seen.pixels / full.pixels,
        truncated=reaches_border(full.box, **size),
        quality=quality,
        corrected_px=corrected_px,
        instance=instance,
    )


def keypoint_visibility(
    camera: Intrinsics,
    around: KeypointSurface,
    rays: RayScene,
    camera_from_object: Transform,
    keypoints_px: Pixels,
    z_m: Float64[np.ndarray, " k"],
    window: Window,
    others_m: DepthPatch,
    measured_m: DepthPatch,
    tolerances: Tolerances,
) -> Int64[np.ndarray, " k"]:
    """COCO's v per keypoint: 0 never clicked, behind the camera or outside the image; 1 hidden; 2 seen.

    Args:
        z_m: depths of the keypoints.
        others_m, measured_m: depth of other objects and of the sensor in the window.
    """
    visibility = np.zeros(len(keypoints_px), dtype=np.int64)
    inside = inside_image(camera, keypoints_px)
    seen = around.faces(rays, camera_from_object)[inside]
    seen &= keypoints_seen(keypoints_px[inside], z_m[inside], window, others_m, measured_m, tolerances)
    visibility[inside] = np.where(seen, 2, 1)
    return visibility


def nearest_other_m(window: Window, others: Iterable[tuple[Window, OtherPatch]]) -> DepthPatch:
    """Depth of the nearest of other objects in a window, from that in their own windows; FAR_M = none."""
    rows, columns = window
    nearest = np.full((rows.stop - rows.start, columns.stop - columns.start), FAR_M, np.float32)
    for there_window, depth_m in others:
        common = overlap(window, there_window)
        if common is not None:
            here, there = common
            np.minimum(nearest[here], depth_m[there], out=nearest[here])
    return nearest


def square_around(keypoints_px: Pixels, box_full: Box) -> SquareBox:
    """The paper's square box around the keypoints; around the mask where fewer than two of them project."""
    known = keypoints_px[np.isfinite(keypoints_px).all(axis=1)]
    if len(known) < 2:
        known = np.array(box_full).reshape(2, 2) - 0.5
    return square_box(known)
