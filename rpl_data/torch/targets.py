"""What an image shows, as torchvision's models and transforms take it: boxes, masks and keypoints.

torchvision's transforms count boxes and keypoints from the edge of the first pixel, everything else here
counts keypoints from its centre. So `points`, which the transforms move, is half a pixel more than
`keypoints`, which the models read.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict, cast

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torchvision import tv_tensors

from rpl_data.json_arrays import Json
from rpl_data.types import DataError

EDGE_FROM_CENTRE_PX = 0.5
"""What a position counted from the edge of the first pixel is more than one counted from its centre."""


class InstanceTarget(TypedDict):
    """What torchvision's detection models are trained with: `InstanceDataset` says what each key holds."""

    boxes: Tensor
    labels: Tensor
    masks: Tensor
    image_id: int
    area: Tensor
    iscrowd: Tensor
    keypoints: Tensor
    points: Tensor
    visibility: Tensor


InstanceSample = tuple[Tensor, InstanceTarget]


def pair_of(returned: object) -> InstanceSample:
    """What transforms returned: the image and its target; DataError where it is anything else."""
    match returned:
        case (
            Tensor() as image,
            {"boxes": _, "labels": _, "masks": _, "points": _, "visibility": _} as target,
        ):
            return image, cast(InstanceTarget, target)
    raise DataError(
        "the transforms must return two things, a tensor with the image and the target with all its keys, as "
        f"they are called with them; got {type(returned).__name__}"
    )


def target_of(image: Json, annotations: Sequence[Json], most_keypoints: int) -> InstanceTarget:
    """Convert the annotations of an image; keypoints are padded with zeros to `most_keypoints`."""
    size = (image["height"], image["width"])
    flat = np.zeros((len(annotations), most_keypoints, 3), dtype=np.float32)
    for row, annotation in enumerate(annotations):
        mine = np.array(annotation.get("keypoints", ()), dtype=np.float32).reshape(-1, 3)
        flat[row, : len(mine)] = mine
    keypoints = torch.from_numpy(flat)
    xywh = np.array([a["bbox"] for a in annotations], dtype=np.float32).reshape(-1, 4)
    boxes = np.concatenate([xywh[:, :2], xywh[:, :2] + xywh[:, 2:]], axis=1)
    return {
        "boxes": tv_tensors.BoundingBoxes(boxes, format=tv_tensors.BoundingBoxFormat.XYXY, canvas_size=size),
        "labels": torch.tensor([a["category_id"] for a in annotations], dtype=torch.int64),
        "masks": tv_tensors.Mask(decoded_masks([a["segmentation"] for a in annotations], size)),
        "image_id": image["id"],
        "area": torch.tensor([a["area"] for a in annotations], dtype=torch.float32),
        "iscrowd": torch.tensor([int(a.get("iscrowd", 0)) for a in annotations], dtype=torch.int64),
        "keypoints": keypoints,
        "points": points_from_keypoints(keypoints, size),
        "visibility": keypoints[..., 2].to(torch.int64),
    }


def rows_by_image(annotations: Sequence[Json]) -> dict[int, list[int]]:
    """The rows of the annotations of each image, by its id; nothing for an image without any."""
    rows: dict[int, list[int]] = {}
    for row, annotation in enumerate(annotations):
        rows.setdefault(annotation["image_id"], []).append(row)
    return rows


def decoded_masks(segmentations: Sequence[Json], size: tuple[int, int]) -> Tensor:
    """Decode the masks of an image of that height and width: n x height x width, uint8."""
    from pycocotools import mask as masks

    if not segmentations:
        return torch.zeros((0, *size), dtype=torch.uint8)
    columns_first = masks.decode(list(segmentations)).T  # n x width x height
    return torch.from_numpy(np.stack([cv2.transpose(mask) for mask in columns_first]))


def points_from_keypoints(keypoints: Float[Tensor, "n k 3"], size: tuple[int, int]) -> tv_tensors.KeyPoints:
    """Return positions that torchvision's transforms move with an image of that height and width.

    They count from the edge of the first pixel, as boxes do; NaN where v is 0.
    """
    xy = keypoints[..., :2] + EDGE_FROM_CENTRE_PX
    known = keypoints[..., 2:] > 0
    return tv_tensors.KeyPoints(torch.where(known, xy, torch.nan), canvas_size=size)


def keypoints_from_points(
    points: tv_tensors.KeyPoints, visibility: Int[Tensor, "n k"]
) -> Float[Tensor, "n k 3"]:
    """Return x, y, v, counted from the centre of the first pixel; 0, 0, 0 where x, y is not in the image."""
    height, width = points.canvas_size
    xy = points.as_subclass(Tensor)
    edge = torch.tensor([width, height], dtype=xy.dtype, device=xy.device)
    inside = ((xy >= 0) & (xy < edge)).all(dim=-1) & (visibility > 0)  # False for NaN
    xyv = torch.cat([xy - EDGE_FROM_CENTRE_PX, visibility.to(xy.dtype).unsqueeze(-1)], dim=-1)
    return torch.where(inside.unsqueeze(-1), xyv, 0.0)


def settled(target: InstanceTarget) -> InstanceTarget:
    """Complete a target that torchvision's transforms have moved; `InstanceDataset` does it by itself.

    `keypoints` and `visibility` follow `points`, `area` follows `masks`, and instances without a visible
    pixel are dropped: the models refuse their boxes.

    Raises:
        DataError: the transforms dropped boxes and not the rest, as SanitizeBoundingBoxes does.
    """
    boxes, points = target["boxes"], target["points"]
    counts = {key: len(target[key]) for key in ("boxes", "masks", "labels", "points", "visibility")}
    if len(set(counts.values())) > 1:
        found = ", ".join(f"{count} {key}" for key, count in counts.items())
        raise DataError(
            f"image {target['image_id']}: the transforms left {found}; leave SanitizeBoundingBoxes out, "
            "instances without a visible pixel are dropped afterwards"
        )
    if not isinstance(points, tv_tensors.KeyPoints) or not isinstance(boxes, tv_tensors.BoundingBoxes):
        raise DataError(
            f"image {target['image_id']}: the transforms returned plain tensors for boxes or points; wrap "
            "them as they came: tv_tensors.wrap(moved, like=target['points'])"
        )
    area = target["masks"].as_subclass(Tensor).sum(dim=(1, 2), dtype=torch.float32)
    plain = boxes.as_subclass(Tensor)
    kept = (area > 0) & (plain[:, 2:] > plain[:, :2]).all(dim=1)
    keypoints = keypoints_from_points(points, target["visibility"])
    complete: InstanceTarget = {
        **target,
        "area": area,
        "keypoints": keypoints,
        "visibility": keypoints[..., 2].to(torch.int64),
    }
    return complete if bool(kept.all()) else chosen(complete, kept)


def chosen(target: InstanceTarget, kept: Tensor) -> InstanceTarget:
    """Return the target with the instances that `kept` is True for."""
    rows: dict[str, Tensor] = {
        key: tv_tensors.wrap(value[kept], like=value)
        for key, value in target.items()
        if isinstance(value, Tensor)
    }
    return {**target, **rows}  # type: ignore[typeddict-item]
