"""Labels of rendered objects: exact, since poses and surfaces are those that were drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rpl_data.geometry import transform
from rpl_data.label.certainty import quality
from rpl_data.label.instance import instance_label, keypoint_visibility, nearest_other_m
from rpl_data.label.occlusion import FAR_M, Tolerances
from rpl_data.raycast import PixelTable
from rpl_data.synthesize.render import Alone, Placed
from rpl_data.synthesize.studio import Subject
from rpl_data.types import InstanceLabel

Drawn = tuple[str, Placed, Alone]


def rendered_label(
    table: PixelTable, drawn: Drawn, objects: Sequence[Drawn], subject: Subject
) -> InstanceLabel:
    """Label an object of a rendered image as the label stage would, without measured depth in its way.

    Args:
        objects: all objects of the image, this one included.
    """
    name, placed, alone = drawn
    pose, body = placed.camera_from_object, placed.body
    others = nearest_other_m(
        alone.window, [(other[2].window, other[2].depth_m) for other in objects if other is not drawn]
    )
    points = transform(pose, body.points_object)
    keypoints_px = table.project(points)
    visibility = keypoint_visibility(
        table.intrinsics,
        body.around,
        body.rays,
        pose,
        keypoints_px,
        points[:, 2],
        alone.window,
        others,
        np.zeros_like(others),
        Tolerances(),
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma_px = np.where(
            visibility > 0, subject.keypoint_sigma_m * table.intrinsics.fx / points[:, 2], np.nan
        )
    return instance_label(
        table.intrinsics,
        name=name,
        camera_from_object=pose,
        keypoints_px=keypoints_px,
        visibility=visibility,
        sigma_px=sigma_px,
        window=alone.window,
        mask=alone.mask,
        visible=alone.mask & ~(others < np.where(alone.mask, alone.depth_m, FAR_M)),
        quality=quality(sigma_px),
    )
