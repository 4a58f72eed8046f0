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

from rpl_data.formats.datasets.coco import read_coco
from rpl_data.torch.images import read_image, to_unit_range
from rpl_data.torch.transforms import Image


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
