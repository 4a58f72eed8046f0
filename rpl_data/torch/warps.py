"""Warp images by an affine map, together with the masks, boxes and keypoints of their instances."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torchvision import tv_tensors

from rpl_data.torch.augmentation import refuse_for_one_object
from rpl_data.torch.colours import jittered
from rpl_data.torch.image_files import to_unit_range
from rpl_data.torch.targets import InstanceSample, InstanceTarget, points_from_keypoints
from rpl_data.torch.transforms import (
    FULL_FROM_HALF,
    Affine,
    Augmentation,
    Image,
    chained,
    moved,
    random_crop_from_square,
    warped,
    warped_smoothly,
)


class RandomAffine:
    """Shift, zoom, rotate and colour an image at random, and move everything in its target with it."""

    def __init__(self, augmentation: Augmentation) -> None:
        """Take the amounts; `augmentation.shift` is a share of the image's longer side."""
        refuse_for_one_object(augmentation)
        self._augmentation = augmentation

    def __call__(self, image: Tensor, target: InstanceTarget) -> InstanceSample:
        """Return a changed image of the same size; instances that leave it are dropped from the target."""
        rng = np.random.default_rng(int(torch.randint(2**62, ()).item()))
        height, width = image.shape[-2:]
        side = max(height, width)
        centre = np.array([(width - 1) / 2, (height - 1) / 2])
        out_from_image = random_crop_from_square(centre, float(side), self._augmentation, rng, input_px=side)
        out_from_image[:, 2] += centre - (side - 1) / 2  # from the square's centre to the image's centre
        return warp_instances(image, target, out_from_image, augmentation=self._augmentation, rng=rng)


def warp_instances(
    image: Tensor,
    target: InstanceTarget,
    out_from_image: Affine,
    *,
    augmentation: Augmentation | None = None,
    rng: np.random.Generator | None = None,
) -> InstanceSample:
    """Warp as `warp_pixels` an image that is already a tensor (float32, 0 to 1), keeping its size."""
    pixels = (image.permute(1, 2, 0).numpy() * 255).round().astype(np.uint8)
    return warp_pixels(pixels, target, out_from_image, augmentation=augmentation, rng=rng)


def warp_pixels(
    pixels: Image,
    target: InstanceTarget,
    out_from_image: Affine,
    *,
    size: tuple[int, int] | None = None,
    halved: bool = False,
    smallest_px: int = 1,
    augmentation: Augmentation | None = None,
    rng: np.random.Generator | None = None,
) -> InstanceSample:
    """Move image, masks, boxes, areas and keypoints together; boxes are taken from the moved masks.

    Keypoints that leave the image become 0, 0, 0.

    Args:
        out_from_image: map from the full-size image, which the target's masks belong to.
        size: width and height of the result; those of `pixels` when left out.
        halved: whether `pixels` is the image at half its size.
        smallest_px: instances whose box is narrower or lower than this are dropped.
        augmentation, rng: the colours are changed too when both are given.
    """
    width, height = size or (pixels.shape[1], pixels.shape[0])
    out_from_pixels = chained(out_from_image, FULL_FROM_HALF) if halved else out_from_image
    pixels = warped_smoothly(pixels, out_from_pixels, size=(width, height))
    if augmentation is not None and rng is not None:
        pixels = jittered(pixels, augmentation, rng)
    white = target["masks"].numpy() * np.uint8(255)
    masks = [warped(mask, out_from_image, size=(width, height)) > 127 for mask in white]
    edges = {row: _box(mask) for row, mask in enumerate(masks) if mask.any()}
    kept = [row for row, (x0, y0, x1, y1) in edges.items() if min(x1 - x0, y1 - y0) >= smallest_px]
    stacked = np.array([masks[row] for row in kept], dtype=np.uint8).reshape(-1, height, width)
    boxes = np.array([edges[row] for row in kept], dtype=np.float32).reshape(-1, 4)
    keypoints = _moved_keypoints(target["keypoints"][kept], out_from_image, width=width, height=height)
    moved_target: InstanceTarget = {
        "boxes": tv_tensors.BoundingBoxes(
            boxes, format=tv_tensors.BoundingBoxFormat.XYXY, canvas_size=(height, width)
        ),
        "labels": target["labels"][kept],
        "masks": tv_tensors.Mask(torch.from_numpy(stacked)),
        "image_id": target["image_id"],
        "area": torch.from_numpy(stacked.sum(axis=(1, 2), dtype=np.float32)),
        "iscrowd": target["iscrowd"][kept],
        "keypoints": keypoints,
        "points": points_from_keypoints(keypoints, (height, width)),
        "visibility": keypoints[..., 2].to(torch.int64),
    }
    return tv_tensors.Image(to_unit_range(pixels)), moved_target


def _box(mask: np.ndarray) -> tuple[int, int, int, int]:
    """Bounding box, with COCO's edges, of a mask with at least one pixel."""
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def _moved_keypoints(keypoints: Tensor, out_from_image: Affine, *, width: int, height: int) -> Tensor:
    xyv = keypoints.numpy().astype(float)
    xy = moved(out_from_image, xyv[..., :2])
    inside = ((xy >= -0.5) & (xy < np.array([width, height]) - 0.5)).all(axis=-1) & (xyv[..., 2] > 0)
    xyv = np.where(inside[..., None], np.concatenate([xy, xyv[..., 2:]], axis=-1), 0.0)
    return torch.from_numpy(xyv.astype(np.float32))
