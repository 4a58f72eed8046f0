"""Whole images with boxes, labels and masks: torchvision's detection targets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypedDict

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset, get_worker_info
from torchvision import tv_tensors

from rpl_data.formats.coco import read_coco
from rpl_data.torch.keypoints import to_unit_range
from rpl_data.torch.regions import read_image
from rpl_data.torch.transforms import (
    FULL_FROM_HALF,
    Affine,
    Augmentation,
    Image,
    chained,
    jittered,
    moved,
    random_crop_from_square,
    warped,
    warped_smoothly,
)


class InstanceTarget(TypedDict):
    """What torchvision's detection models are trained with; n instances, n may be 0.

    Attributes:
        boxes: n x 4, float32, x0 y0 x1 y1 with COCO's edges (of the visible mask).
        labels: n, int64, category ids from 1; 0 is the background.
        masks: n x height x width, uint8, visible pixels.
        image_id: of the COCO file.
        area: n, float32, visible pixels.
        iscrowd: n, int64, zeros.
        keypoints: n x k x 3, float32, x y v in pixels (centre of the first pixel is 0); objects with fewer
            keypoints than the largest have rows of zeros behind.
    """

    boxes: Tensor
    labels: Tensor
    masks: Tensor
    image_id: int
    area: Tensor
    iscrowd: Tensor
    keypoints: Tensor


InstanceSample = tuple[Tensor, InstanceTarget]
Json = dict[str, Any]


class InstanceDataset(Dataset[InstanceSample]):
    """Every image of an exported COCO file, those without an object too.

    Attributes:
        names: of the labels, `names[0]` is the background.
    """

    def __init__(
        self, coco_json: Path, transforms: Callable[[Tensor, InstanceTarget], InstanceSample] | None = None
    ) -> None:
        """Read the annotations; images stay on disk.

        Args:
            coco_json: a file that `rpl export` wrote.
            transforms: called with the image (float32, 3 x height x width, 0 to 1) and its target, both made
                of tv_tensors, so that torchvision.transforms.v2 can be given; or `RandomAffine`. Do not flip:
                a mirrored object is another object.
        """
        data = read_coco(Path(coco_json))
        by_id = sorted(data["categories"], key=lambda category: int(category["id"]))
        self.names = ["background", *(category["name"] for category in by_id)]
        self._most_keypoints = max((len(c["keypoints"]) for c in data["categories"]), default=0)
        self._folder, self._transforms = Path(coco_json).parent, transforms
        self._images: list[Json] = data["images"]
        self._annotations: dict[int, list[Json]] = {image["id"]: [] for image in self._images}
        for annotation in data["annotations"]:
            self._annotations[annotation["image_id"]].append(annotation)

    def __len__(self) -> int:
        """How many images."""
        return len(self._images)

    def file_name(self, image_id: int) -> str:
        """The file of an image, for messages."""
        return next(str(image["file_name"]) for image in self._images if image["id"] == image_id)

    def __getitem__(self, row: int) -> InstanceSample:
        """An image and its target."""
        pixels, target = self.read(row)
        image = tv_tensors.Image(to_unit_range(pixels))
        return (image, target) if self._transforms is None else self._transforms(image, target)

    def size(self, row: int) -> tuple[int, int]:
        """Width and height of an image, pixels."""
        return self._images[row]["width"], self._images[row]["height"]

    def read(self, row: int, *, halved: bool = False) -> tuple[Image, InstanceTarget]:
        """An image as in its file (RGB), or `halved`, and the target of the whole one; no transforms."""
        if get_worker_info() is not None:
            cv2.setNumThreads(0)  # as in KeypointDataset
        entry = self._images[row]
        target = _target(entry, self._annotations[entry["id"]], self._most_keypoints)
        return read_image(str(self._folder / entry["file_name"]), halved=halved), target


def collate(batch: Sequence[InstanceSample]) -> tuple[list[Tensor], list[InstanceTarget]]:
    """Images and targets as two lists, as torchvision's detection models take them."""
    return [image for image, _ in batch], [target for _, target in batch]


def _target(image: Json, annotations: Sequence[Json], most_keypoints: int) -> InstanceTarget:
    size = (image["height"], image["width"])
    keypoints = np.zeros((len(annotations), most_keypoints, 3), dtype=np.float32)
    for row, annotation in enumerate(annotations):
        mine = np.array(annotation["keypoints"], dtype=np.float32).reshape(-1, 3)
        keypoints[row, : len(mine)] = mine
    xywh = np.array([a["bbox"] for a in annotations], dtype=np.float32).reshape(-1, 4)
    boxes = np.concatenate([xywh[:, :2], xywh[:, :2] + xywh[:, 2:]], axis=1)
    return {
        "boxes": tv_tensors.BoundingBoxes(boxes, format=tv_tensors.BoundingBoxFormat.XYXY, canvas_size=size),
        "labels": torch.tensor([a["category_id"] for a in annotations], dtype=torch.int64),
        "masks": tv_tensors.Mask(_masks(annotations, size)),
        "image_id": image["id"],
        "area": torch.tensor([a["area"] for a in annotations], dtype=torch.float32),
        "iscrowd": torch.zeros(len(annotations), dtype=torch.int64),
        "keypoints": torch.from_numpy(keypoints),
    }


def _masks(annotations: Sequence[Json], size: tuple[int, int]) -> Tensor:
    """N x height x width, uint8."""
    from pycocotools import mask as masks

    if not annotations:
        return torch.zeros((0, *size), dtype=torch.uint8)
    columns_first = masks.decode([a["segmentation"] for a in annotations]).T  # n x width x height
    return torch.from_numpy(np.stack([cv2.transpose(mask) for mask in columns_first]))


class RandomAffine:
    """Shifts, zooms, turns and colours an image at random, and everything in its target with it."""

    def __init__(self, augmentation: Augmentation) -> None:
        """`augmentation.shift` is a share of the image's longer side."""
        self._augmentation = augmentation

    def __call__(self, image: Tensor, target: InstanceTarget) -> InstanceSample:
        """Another view of the same size; instances that leave the image leave the target."""
        rng = np.random.default_rng(int(torch.randint(2**62, ()).item()))
        height, width = image.shape[-2:]
        side = max(height, width)
        centre = np.array([(width - 1) / 2, (height - 1) / 2])
        out_from_image = random_crop_from_square(centre, float(side), self._augmentation, rng, input_px=side)
        out_from_image[:, 2] += centre - (side - 1) / 2  # from the middle of a square to the image's
        return warp_instances(image, target, out_from_image, augmentation=self._augmentation, rng=rng)


def warp_instances(
    image: Tensor,
    target: InstanceTarget,
    out_from_image: Affine,
    *,
    augmentation: Augmentation | None = None,
    rng: np.random.Generator | None = None,
) -> InstanceSample:
    """`warp_pixels` of an image that is a tensor already (float32, 0 to 1); its size stays."""
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
    """Image, masks, boxes, areas and keypoints moved together; boxes are those of the moved masks.

    Keypoints that leave the image become 0, 0, 0.

    Args:
        out_from_image: from the whole image, whose masks the target has.
        size: width and height of what comes out; those of `pixels` when left out.
        halved: `pixels` are the image at half its size.
        smallest_px: instances whose box is narrower or lower than this leave the target.
        augmentation, rng: colours are changed when both are given.
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
    moved_target: InstanceTarget = {
        "boxes": tv_tensors.BoundingBoxes(
            boxes, format=tv_tensors.BoundingBoxFormat.XYXY, canvas_size=(height, width)
        ),
        "labels": target["labels"][kept],
        "masks": tv_tensors.Mask(torch.from_numpy(stacked)),
        "image_id": target["image_id"],
        "area": torch.from_numpy(stacked.sum(axis=(1, 2), dtype=np.float32)),
        "iscrowd": target["iscrowd"][kept],
        "keypoints": _moved_keypoints(target["keypoints"][kept], out_from_image, width=width, height=height),
    }
    return tv_tensors.Image(to_unit_range(pixels)), moved_target


def _box(mask: np.ndarray) -> tuple[int, int, int, int]:
    """COCO's edges of a mask with at least one pixel."""
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def _moved_keypoints(keypoints: Tensor, out_from_image: Affine, *, width: int, height: int) -> Tensor:
    xyv = keypoints.numpy().astype(float)
    xy = moved(out_from_image, xyv[..., :2])
    inside = ((xy >= -0.5) & (xy < np.array([width, height]) - 0.5)).all(axis=-1) & (xyv[..., 2] > 0)
    xyv = np.where(inside[..., None], np.concatenate([xy, xyv[..., 2:]], axis=-1), 0.0)
    return torch.from_numpy(xyv.astype(np.float32))
