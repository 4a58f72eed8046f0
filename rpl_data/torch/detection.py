"""Dataset of small whole images, for the detector that finds the square boxes of the paper's hourglass."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TypedDict

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from rpl_data.formats.datasets.coco_parts import read_packed
from rpl_data.torch.augmentation import refuse_for_one_object
from rpl_data.torch.colours import jittered
from rpl_data.torch.image_files import read_image, to_unit_range
from rpl_data.torch.scenes import only_scenes
from rpl_data.torch.splits import split_file
from rpl_data.torch.targets import rows_by_image
from rpl_data.torch.transforms import Augmentation, moved, random_crop_from_square, warped
from rpl_data.types import DataError

IMAGE_KEYS = ("id", "file_name", "scene", "width", "height")
BOX_KEYS = ("image_id", "category_id", "square_box")
MARGIN = 1.5
"""Side of the paper's square box, as a multiple of the keypoints' bounding box (section III-E)."""


class DetectionTarget(TypedDict):
    """Training target of torchvision's detectors, for n instances; n may be 0.

    Attributes:
        boxes: n x 4, float32, x0 y0 x1 y1 with COCO's edges: the square boxes without their margin.
        labels: n, int64, category ids from 1.
        image_id: id of the image in the COCO file.
    """

    boxes: Tensor
    labels: Tensor
    image_id: int


class DetectionDataset(Dataset[tuple[Tensor, DetectionTarget]]):
    """Every image of an exported dataset, shrunk, and kept in memory once decoded.

    ::

        image, target = DetectionDataset("my-workspace/export/coco", split="train")[0]

    `image` is float32, 3 x height x width, RGB, 0 to 1. `target` has, for n instances (n may be 0): `boxes`
    (float32, n x 4: x0 y0 x1 y1 in pixels of the small image, the paper's square boxes without their margin),
    `labels` (int64, n: category ids from 1) and `image_id` (int, of the COCO file).

    Attributes:
        names: name of each label; `names[0]` is the background.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        split: str | None = None,
        width_px: int = 256,
        augment: Augmentation | None = None,
        scenes: Collection[str] | None = None,
    ) -> None:
        """Read the annotations; an image is decoded when it is first asked for.

        Args:
            path: the folder of an export (my-workspace/export/coco), or one of its JSON files.
            split: train, val or test, when `path` is a folder.
            width_px: width of the shrunk images; they keep their aspect ratio.
            augment: random shifts (as a share of the width), zooms and colours; boxes stay upright, so
                `rotation_deg` must be 0.
            scenes: only the images of these; None for all.

        Raises:
            DataError: there is no such split (the message says why), the file is not an export of rpl-data,
                it has no image, boxes would be rotated, or the width is not above 0.
        """
        if width_px < 1:
            raise DataError(f"width_px is {width_px}; it must be above 0")
        if augment is not None and augment.rotation_deg:
            raise DataError(f"rotation_deg is {augment.rotation_deg}; a rotated box is not upright: give 0")
        if augment is not None:
            refuse_for_one_object(augment)
        coco_json = split_file(path, split)
        data = only_scenes(read_packed(coco_json, {"images": IMAGE_KEYS, "annotations": BOX_KEYS}), scenes)
        if not data["images"]:
            raise DataError(f"{coco_json} has no images; train on another split")
        by_id = sorted(data["categories"], key=lambda category: int(category["id"]))
        self.names = ["background", *(category["name"] for category in by_id)]
        self._folder, self._width_px, self._augment = coco_json.parent, width_px, augment
        self._images, self._annotations = data["images"], data["annotations"]
        self._rows_of = rows_by_image(self._annotations)
        self._pixels: dict[int, np.ndarray] = {}

    def __len__(self) -> int:
        """Number of images."""
        return len(self._images)

    def labelled(self) -> int:
        """How many instances the images show."""
        return len(self._annotations)

    def __getitem__(self, row: int) -> tuple[Tensor, DetectionTarget]:
        """Return an image (3 x height x width, 0 to 1) and its target."""
        entry = self._images[row]
        if row not in self._pixels:
            size = entry["width"], entry["height"]
            whole = read_image(str(self._folder / entry["file_name"]), size=size)
            self._pixels[row] = shrunk(whole, self._width_px)
        pixels = self._pixels[row]
        annotations = [self._annotations[number] for number in self._rows_of.get(entry["id"], ())]
        squares = np.array([a["square_box"] for a in annotations], dtype=float).reshape(-1, 3)
        boxes = small_from_full_boxes(_tight(squares), self._width_px / entry["width"])
        labels = torch.tensor([a["category_id"] for a in annotations], dtype=torch.int64)
        if self._augment is not None:
            pixels, boxes = _augmented(pixels, boxes, self._augment)
        inside = _centres_inside(boxes, width=pixels.shape[1], height=pixels.shape[0])
        return to_unit_range(pixels), {
            "boxes": torch.from_numpy(boxes[inside].astype(np.float32)),
            "labels": labels[torch.from_numpy(inside)],
            "image_id": entry["id"],
        }


def shrunk(image: np.ndarray, width_px: int) -> np.ndarray:
    """Shrink the image to `width_px`, keeping its aspect ratio; each pixel is the mean of those it covers."""
    height_px = round(image.shape[0] * width_px / image.shape[1])
    small: np.ndarray = cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA)
    return small


def small_from_full_boxes(boxes_px: np.ndarray, zoom: float) -> np.ndarray:
    """Scale boxes to an image resized by `zoom`; COCO's edges need no half-pixel offset."""
    return boxes_px * zoom


def square_from_box(box_px: np.ndarray) -> np.ndarray:
    """Return the paper's square (cx, cy, side; pixel centres are whole numbers) of a detected tight box."""
    x0, y0, x1, y1 = box_px
    return np.array([(x0 + x1) / 2 - 0.5, (y0 + y1) / 2 - 0.5, MARGIN * max(x1 - x0, y1 - y0)])


def _tight(squares: np.ndarray) -> np.ndarray:
    half = squares[:, 2:] / 2 / MARGIN
    return np.concatenate([squares[:, :2] + 0.5 - half, squares[:, :2] + 0.5 + half], axis=1)


def _augmented(
    pixels: np.ndarray, boxes: np.ndarray, augmentation: Augmentation
) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(int(torch.randint(2**62, ()).item()))
    height, width = pixels.shape[:2]
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    out_from_image = random_crop_from_square(centre, float(width), augmentation, rng, input_px=width)
    out_from_image[:, 2] += centre - (width - 1) / 2
    corners = moved(out_from_image, boxes.reshape(-1, 2) - 0.5) + 0.5  # edges as pixel positions and back
    image = warped(pixels, out_from_image, size=(width, height))
    return jittered(image, augmentation, rng), corners.reshape(-1, 4)


def _centres_inside(boxes: np.ndarray, *, width: int, height: int) -> np.ndarray:
    centres = (boxes[:, :2] + boxes[:, 2:]) / 2
    inside: np.ndarray = ((centres > 0) & (centres < [width, height])).all(axis=1)
    return inside
