"""Pipelines of albumentations and kornia as transforms of `InstanceDataset` and `KeypointDataset`.

Neither package is imported here: the pipelines that you made are called. Both count keypoints from the centre
of the first pixel; that is converted. Both draw their random numbers by torch's random state, so seeds,
workers and resumed trainings behave as with our own augmentation.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torchvision import tv_tensors

from rpl_data.torch.targets import EDGE_FROM_CENTRE_PX, InstanceSample, InstanceTarget
from rpl_data.torch.views import Transforms


def from_albumentations(pipeline: Any) -> Transforms:
    """Make transforms of an albumentations `Compose`, given without bbox_params.

    It needs ``keypoint_params=A.KeypointParams("xy", remove_invisible=False)``, so that keypoints outside
    the image keep their row. Boxes are taken from the moved masks.
    """

    def transforms(image: Tensor, target: InstanceTarget) -> InstanceSample:
        pipeline.set_random_seed(int(torch.randint(2**31, ()).item()))
        xy = _centred(target)
        moved = pipeline(
            image=np.ascontiguousarray(image.permute(1, 2, 0).numpy()),
            masks=list(target["masks"].numpy()),
            keypoints=np.nan_to_num(xy.reshape(-1, 2).numpy(), nan=0.0),
        )
        pixels = torch.from_numpy(np.ascontiguousarray(moved["image"].transpose(2, 0, 1)))
        size = (int(pixels.shape[1]), int(pixels.shape[2]))
        masks = np.array(moved["masks"], dtype=np.uint8).reshape(-1, *size)
        points = torch.from_numpy(np.array(moved["keypoints"], dtype=np.float32)).reshape(xy.shape)
        return _rebuilt(pixels, target, torch.from_numpy(masks), points)

    return transforms


def from_kornia(pipeline: Any) -> Transforms:
    """Make transforms of a kornia `AugmentationSequential` with ``data_keys=["input", "mask", "keypoints"]``.

    Boxes are taken from the moved masks.
    """

    def transforms(image: Tensor, target: InstanceTarget) -> InstanceSample:
        xy = _centred(target)
        masks = target["masks"].as_subclass(Tensor).float()[None]
        flat = xy.reshape(1, -1, 2).nan_to_num(nan=0.0)
        pixels, moved_masks, points = pipeline(image.as_subclass(Tensor)[None], masks, flat)
        moved_masks = (moved_masks[0] > 0.5).to(torch.uint8)
        return _rebuilt(pixels[0], target, moved_masks, torch.as_tensor(points).reshape(xy.shape))

    return transforms


def _centred(target: InstanceTarget) -> Tensor:
    """Positions counted from the centre of the first pixel; NaN without a label."""
    return target["points"].as_subclass(Tensor) - EDGE_FROM_CENTRE_PX


def _rebuilt(image: Tensor, target: InstanceTarget, masks: Tensor, xy: Tensor) -> InstanceSample:
    """The target with moved masks and positions, and the boxes of the masks (empty ones for empty masks)."""
    size = (int(image.shape[-2]), int(image.shape[-1]))
    boxes = torch.stack([_box(mask) for mask in masks]) if len(masks) else torch.zeros(0, 4)
    points = torch.where(target["points"].as_subclass(Tensor).isnan(), torch.nan, xy + EDGE_FROM_CENTRE_PX)
    moved: InstanceTarget = {
        **target,
        "boxes": tv_tensors.BoundingBoxes(boxes, format=tv_tensors.BoundingBoxFormat.XYXY, canvas_size=size),
        "masks": tv_tensors.Mask(masks),
        "points": tv_tensors.KeyPoints(points, canvas_size=size),
    }
    return tv_tensors.Image(image), moved


def _box(mask: Tensor) -> Tensor:
    columns, rows = mask.any(dim=0).nonzero(), mask.any(dim=1).nonzero()
    if not len(columns):
        return torch.zeros(4)
    return torch.stack([columns[0, 0], rows[0, 0], columns[-1, 0] + 1, rows[-1, 0] + 1]).float()
