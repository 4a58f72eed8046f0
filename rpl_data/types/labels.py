"""Labels, and their errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.types.images import Box, Rle, SquareBox


@dataclass(frozen=True)
class InstanceLabel:
    """One instance of an object in one frame.

    Attributes:
        instance: its name where a scene shows several of the object (`types.instances`); empty for the one
            without a name.
        keypoints_px: projected keypoints, possibly outside the image; NaN where the keypoint has
            no position or lies behind the camera.
        visibility: COCO's v of each keypoint: 0 not labelled, 1 hidden, 2 seen.
        sigma_px: standard deviation of each projected keypoint; NaN where v = 0.
        box: box of the visible mask; None when nothing is visible.
        box_full: box of the full mask, clipped to the image.
        mask: visible pixels.
        mask_full: all pixels that the object would cover if nothing hid it.
        visib_fract: visible share of the full mask's pixels.
        truncated: whether the object extends beyond the image.
        quality: from 1 (certain) to 0: 1 / (1 + e / 5 px), where e is the label's expected error.
        corrected_px: how far the frame's own colours moved the keypoints from where the trajectory puts them
            (root mean square); None where the label follows the trajectory.
        corrected: whether a person changed the mask or keypoints in another program (`rpl labels import`).
        crowd: whether a person marked it as a region that trainers and scores ignore.
    """

    object: str
    camera_from_object: Float64[np.ndarray, "4 4"]
    keypoints_px: Float64[np.ndarray, "k 2"]
    visibility: Int64[np.ndarray, " k"]
    sigma_px: Float64[np.ndarray, " k"]
    square_box: SquareBox
    box: Box | None
    box_full: Box
    mask: Rle
    mask_full: Rle
    visib_fract: float
    truncated: bool
    quality: float
    corrected_px: float | None = None
    corrected: bool = False
    crowd: bool = False
    instance: str = ""


@dataclass(frozen=True)
class Correction:
    """What a person changed in a label with another program; the label itself may be made again.

    Attributes:
        instance: as `InstanceLabel.instance`.
        deleted: the instance is not exported.
        crowd: it is exported with `iscrowd`.
        mask: its visible pixels; None where they were not changed.
        keypoints: u, v in pixels and COCO's visibility of each changed keypoint, by its name.
    """

    scene: str
    frame: int
    object: str
    deleted: bool = False
    crowd: bool = False
    mask: Rle | None = None
    keypoints: Mapping[str, tuple[float, float, int]] = field(default_factory=dict)
    instance: str = ""


@dataclass(frozen=True)
class FrameLabel:
    """The labels of one frame; objects that are not in the image have no instance."""

    scene: str
    frame: int
    timestamp_s: float
    instances: tuple[InstanceLabel, ...] = field(default=())


@dataclass(frozen=True)
class QualityRow:
    """Errors of an object's model and labels relative to the truth: one row of the printed table.

    NaN where nothing could be measured. 2D errors are means over the labelled keypoints of a frame;
    mean, median and 95th percentile are over frames, as the means and the worst of the IoU are.

    Attributes:
        keypoints_known: how many of the `keypoints` have a position.
        position_mm, rotation_deg: mean pose error after the one rigid alignment of the two models.
        frames: how many of the `truth_frames` have a label.
        missed: labelled frames without this object although the truth has it.
        invented: labelled frames with this object although the truth does not have it.
    """

    object: str
    keypoints: int
    keypoints_known: int
    error_3d_mean_mm: float
    error_3d_max_mm: float
    error_2d_mean_px: float
    error_2d_median_px: float
    error_2d_p95_px: float
    iou_full_mean: float
    iou_full_worst: float
    iou_visible_mean: float
    iou_visible_worst: float
    position_mm: float
    rotation_deg: float
    frames: int
    truth_frames: int
    missed: int
    invented: int
