"""Square crops of an exported dataset, which Mask R-CNN is trained on."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import Dataset

from rpl_data.torch.augmentation import refuse_for_one_object
from rpl_data.torch.instances import InstanceDataset, InstanceSample
from rpl_data.torch.splits import refuse_no_labels
from rpl_data.torch.transforms import Affine, Augmentation, crop_from_square, zoom_of
from rpl_data.torch.warps import warp_pixels
from rpl_data.types import DataError

SMALLEST_PX = 2
"""Instances whose box in the crop is narrower or lower than this are not trained on."""


class SquareCrops(Dataset[InstanceSample]):
    """The paper's training images: a square of the image, resized to `size_px`.

    The square is as wide as the image's shorter side, times the augmentation's scale, and lies anywhere in
    the image. It is drawn from torch's random state.

    Attributes:
        names: of the labels; `names[0]` is the background.
    """

    def __init__(
        self,
        coco_json: Path,
        size_px: int,
        augmentation: Augmentation,
        scenes: Collection[str] | None = None,
    ) -> None:
        """Read the annotations of all scenes, or of some; images stay on disk.

        Raises:
            DataError: the file is not ours, or it has no image, or shows no object.
        """
        refuse_for_one_object(augmentation)
        self._images = InstanceDataset(coco_json, scenes=scenes)
        if not len(self._images):
            raise DataError(f"{coco_json} has no images; export a dataset with a train split")
        refuse_no_labels(self._images.labelled(), coco_json)
        self.names = tuple(self._images.names)
        self._size_px, self._augmentation = size_px, augmentation

    def __len__(self) -> int:
        """How many images."""
        return len(self._images)

    def __getitem__(self, row: int) -> InstanceSample:
        """A random crop of an image, size_px x size_px, and what it shows."""
        width, height = self._images.size(row)
        rng = np.random.default_rng(int(torch.randint(2**62, ()).item()))
        crop_from_image = random_square(width, height, self._augmentation, rng, size_px=self._size_px)
        halved = zoom_of(crop_from_image) <= 0.5 and width % 2 == height % 2 == 0
        pixels, target = self._images.read(row, halved=halved)
        return warp_pixels(
            pixels,
            target,
            crop_from_image,
            size=(self._size_px, self._size_px),
            halved=halved,
            smallest_px=SMALLEST_PX,
            augmentation=self._augmentation,
            rng=rng,
        )


def random_square(
    width: int, height: int, augmentation: Augmentation, rng: np.random.Generator, *, size_px: int
) -> Affine:
    """The map from the image to a random square crop; `augmentation.shift` may take it over the edge."""
    side = min(width, height) * rng.uniform(1 - augmentation.scale, 1 + augmentation.scale)
    turn = np.deg2rad(augmentation.largest_turn_deg)
    # Where the centre may be without looking over the edge; the middle where there is no room.
    room = np.maximum(np.array([width, height]) - side, 0) / 2 + augmentation.shift * side
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    return crop_from_square(
        middle + rng.uniform(-1, 1, 2) * room, side, input_px=size_px, rotation_rad=rng.uniform(-turn, turn)
    )
