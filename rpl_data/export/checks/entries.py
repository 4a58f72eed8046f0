"""Rules for the entries of our COCO dialect, which WebDataset's shards hold too."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rpl_data.export.checks.findings import Findings
from rpl_data.export.checks.rules import (
    FARTHEST_PX,
    Rules,
    at_least,
    between,
    camera_matrix,
    one_of,
    pixel,
    positive,
    rigid,
    sized,
)
from rpl_data.files import FAULTS
from rpl_data.formats.datasets.coco_edited import check_packed
from rpl_data.json_arrays import Json, each, flag, number, optional, text, whole

IMAGE_RULES: Rules = {
    "id": whole,
    "file_name": text,
    "width": at_least(1),
    "height": at_least(1),
    "scene": text,
    "frame": at_least(0),
    "timestamp_s": number,
    "cam_K": camera_matrix,
    "distortion": each(between(-1e4, 1e4)),
    "scene_from_camera": rigid,
    "depth_file_name": optional(text),
}
DEPTH_RULES: Rules = {"metres_per_unit": positive}
"""Where it is said: exports of earlier versions do not."""


def _segmentation(mask: Any) -> None:
    """Rule: a packed mask."""
    for key in ("size", "counts"):
        if key not in mask:
            raise ValueError(f"{key} is missing")
    try:
        sized(2, at_least(1))(mask["size"])
    except ValueError as error:
        raise ValueError(f"size: {error}") from error
    check_packed(mask)


def _square(values: Any) -> None:
    """Rule: centre and side of a square."""
    sized(3, pixel)(values)
    positive(values[2])


def _keypoints(values: Any) -> None:
    """Rule: u, v and visibility of each keypoint in turn."""
    numbers = each(between(-FARTHEST_PX, FARTHEST_PX))(values)
    if len(numbers) % 3 or any(number(v) not in (0, 1, 2) for v in values[2::3]):
        raise ValueError(f"expected u, v and a visibility of 0, 1 or 2 in turn, found {values!s:.120}")


ANNOTATION_RULES: Rules = {
    "id": whole,
    "image_id": whole,
    "category_id": at_least(1),
    "segmentation": _segmentation,
    "segmentation_full": _segmentation,
    "area": at_least(1),
    "bbox": sized(4, pixel),
    "bbox_full": sized(4, pixel),
    "iscrowd": one_of([0, 1], "0 or 1"),
    "keypoints": _keypoints,
    "num_keypoints": at_least(0),
    "camera_from_object": rigid,
    "visib_fract": between(0, 1),
    "truncated": flag,
    "square_box": _square,
    "sigma_px": each(optional(between(0, FARTHEST_PX))),
    "quality": between(0, 1),
}
BOX_PX = 1e-2


def check_image(findings: Findings, image: Any, file: str, record: str) -> bool:
    """Check the entry of an image by itself; whether it is sound."""
    more = DEPTH_RULES if isinstance(image, dict) and "metres_per_unit" in image else {}
    return findings.fields(image, {**IMAGE_RULES, **more}, file, record)


def check_annotation(
    findings: Findings, annotation: Any, image: Mapping[str, Any], file: str, record: str
) -> bool:
    """Check the entry of an instance beside that of its image; whether it is sound."""
    if not findings.fields(annotation, ANNOTATION_RULES, file, record):
        return False
    before = len(findings.faults)
    findings.equal(file, record, "image_id", annotation["image_id"], image["id"], "the image's id")
    seen = [v for v in annotation["keypoints"][2::3] if v > 0]
    findings.equal(
        file, record, "num_keypoints", annotation["num_keypoints"], len(seen), "the count of v > 0"
    )
    visibility = annotation["keypoints"][2::3]
    findings.equal(file, record, "sigma_px", len(annotation["sigma_px"]), len(visibility), "one per keypoint")
    if any(s is not None and v == 0 for s, v in zip(annotation["sigma_px"], visibility, strict=False)):
        findings.add(file, record, "sigma_px", "expected null where v = 0")
    for kind in ("", "_full"):
        _check_mask(findings, annotation, kind, image, file, record)
    if len(findings.faults) == before:
        _check_nested(findings, annotation, file, record)
    return len(findings.faults) == before


def _check_mask(
    findings: Findings, annotation: Json, kind: str, image: Mapping[str, Any], file: str, record: str
) -> None:
    """The size of a mask is that of its image, and box and area are the mask's."""
    from pycocotools import mask as masks

    mask, field = annotation[f"segmentation{kind}"], f"segmentation{kind}"
    size = [image["height"], image["width"]]
    findings.equal(file, record, f"{field}.size", list(mask["size"]), size, "that of the image")
    try:
        box = masks.toBbox(mask)
    except FAULTS as error:
        findings.add(file, record, field, str(error)[:200])
        return
    if np.abs(box - annotation[f"bbox{kind}"]).max() > BOX_PX:
        found = annotation[f"bbox{kind}"]
        findings.add(file, record, f"bbox{kind}", f"expected the mask's {box.tolist()}, found {found}")
    if not kind:
        findings.equal(file, record, "area", annotation["area"], int(masks.area(mask)), "the mask's pixels")


def _check_nested(findings: Findings, annotation: Json, file: str, record: str) -> None:
    """What is seen of an object lies within all of it."""
    from pycocotools import mask as masks

    pair = [annotation["segmentation"], annotation["segmentation_full"]]
    outside = int(masks.area(masks.merge(pair))) - int(masks.area(pair[1]))
    if outside:
        findings.add(file, record, "segmentation", f"{outside} of its pixels are not in segmentation_full")
