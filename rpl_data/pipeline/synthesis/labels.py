"""Labels of rendered objects: exact, since poses and surfaces are those that were drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int64

from rpl_data.geometry import inside_image, square_box, transform
from rpl_data.label.certainty import quality
from rpl_data.label.masks import box_of, encode, overlap, reaches_border
from rpl_data.label.occlusion import FAR_M, DepthPatch, Tolerances, keypoints_seen
from rpl_data.raycast import PixelTable
from rpl_data.synthesize.render import Alone, Placed
from rpl_data.synthesize.studio import Subject
from rpl_data.types import InstanceLabel, SquareBox

Drawn = tuple[str, Placed, Alone]


def instance_label(
    table: PixelTable, drawn: Drawn, objects: Sequence[Drawn], subject: Subject
) -> InstanceLabel:
    """Label an object of a rendered image as the label stage would, without measured depth in its way.

    Args:
        objects: all objects of the image, this one included.
    """
    name, placed, alone = drawn
    camera, pose = table.intrinsics, placed.camera_from_object
    others = _nearest_other(drawn, objects)
    visible = alone.mask & ~(others < np.where(alone.mask, alone.depth_m, FAR_M))
    points = transform(pose, placed.body.points_object)
    keypoints_px = table.project(points)
    visibility = _visibility(table, placed, alone, keypoints_px, points[:, 2], others)
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma_px = np.where(visibility > 0, subject.keypoint_sigma_m * camera.fx / points[:, 2], np.nan)
    size = {"width": camera.width, "height": camera.height}
    box_full = box_of(alone.mask, alone.window)
    known = keypoints_px[np.isfinite(keypoints_px).all(axis=1)]
    return InstanceLabel(
        object=name,
        camera_from_object=pose,
        keypoints_px=keypoints_px,
        visibility=visibility,
        sigma_px=sigma_px,
        square_box=_square(known, box_full),
        box=box_of(visible, alone.window) if visible.any() else None,
        box_full=box_full,
        mask=encode(visible, alone.window, **size),
        mask_full=encode(alone.mask, alone.window, **size),
        visib_fract=float(visible.sum() / alone.mask.sum()),
        truncated=reaches_border(box_full, **size),
        quality=quality(sigma_px),
    )


def _square(known: np.ndarray, box_full: tuple[float, float, float, float]) -> SquareBox:
    return square_box(known if len(known) else np.array(box_full).reshape(2, 2) - 0.5)


def _visibility(
    table: PixelTable,
    placed: Placed,
    alone: Alone,
    keypoints_px: np.ndarray,
    z_m: np.ndarray,
    others: DepthPatch,
) -> Int64[np.ndarray, " k"]:
    """COCO's v: 0 never clicked or outside the image, 1 hidden, 2 seen."""
    visibility = np.zeros(len(keypoints_px), np.int64)
    inside = inside_image(table.intrinsics, keypoints_px)
    seen = placed.body.around.faces(placed.body.rays, placed.camera_from_object)[inside]
    nothing = np.zeros_like(others)
    seen &= keypoints_seen(keypoints_px[inside], z_m[inside], alone.window, others, nothing, Tolerances())
    visibility[inside] = np.where(seen, 2, 1)
    return visibility


def _nearest_other(drawn: Drawn, objects: Sequence[Drawn]) -> DepthPatch:
    """Depth of the nearest other object in the window; FAR_M = none."""
    alone = drawn[2]
    nearest = np.full(alone.depth_m.shape, FAR_M, np.float32)
    for other in objects:
        common = overlap(alone.window, other[2].window)
        if other is not drawn and common is not None:
            here, there = common
            nearest[here] = np.minimum(nearest[here], other[2].depth_m[there])
    return nearest
