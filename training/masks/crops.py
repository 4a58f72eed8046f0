"""Square crops of an exported dataset for Mask R-CNN, the same for the same seed, epoch and image."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset, Sampler

from rpl_data.torch.instances import InstanceDataset, InstanceSample, collate
from rpl_data.torch.transforms import Affine, Augmentation, crop_from_square, zoom_of
from rpl_data.torch.warps import warp_pixels

SMALLEST_PX = 2
"""Instances of which a crop shows less (a sliver, a degenerate box) are not trained on."""


class SquareCrops(Dataset[InstanceSample]):
    """The paper's training images: a square of the image, resized to `size_px`.

    The square is as wide as the image's shorter side, times the augmentation's scale, and lies anywhere in
    the image. What it shows depends on seed, epoch and row alone, whatever worker makes it: a resumed run
    sees what an uninterrupted one would have seen.
    """

    def __init__(self, coco_json: Path, size_px: int, augmentation: Augmentation, seed: int) -> None:
        """Read the annotations; set `epoch` before every pass."""
        self.images = InstanceDataset(coco_json)
        self.epoch = 0
        self._size_px, self._augmentation, self._seed = size_px, augmentation, seed

    def __len__(self) -> int:
        """How many images."""
        return len(self.images)

    def __getitem__(self, row: int) -> InstanceSample:
        """This epoch's crop of an image."""
        width, height = self.images.size(row)
        rng = np.random.default_rng((self._seed, self.epoch, row))
        crop_from_image = random_square(width, height, self._augmentation, rng, size_px=self._size_px)
        halved = zoom_of(crop_from_image) <= 0.5 and width % 2 == height % 2 == 0
        pixels, target = self.images.read(row, halved=halved)
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
    turn = np.deg2rad(augmentation.rotation_deg)
    # Where the centre may be without looking over the edge; the middle where there is no room.
    room = np.maximum(np.array([width, height]) - side, 0) / 2 + augmentation.shift * side
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    return crop_from_square(
        middle + rng.uniform(-1, 1, 2) * room, side, input_px=size_px, rotation_rad=rng.uniform(-turn, turn)
    )


class EpochOrder(Sampler[int]):
    """All rows in an order that depends on seed and epoch alone."""

    def __init__(self, crops: SquareCrops, seed: int) -> None:
        """The epoch is the dataset's."""
        self._crops, self._seed = crops, seed

    def __len__(self) -> int:
        """How many rows."""
        return len(self._crops)

    def __iter__(self) -> Iterator[int]:
        """The rows."""
        return iter(
            np.random.default_rng((self._seed, self._crops.epoch)).permutation(len(self._crops)).tolist()
        )


def crop_loader(crops: SquareCrops, *, batch: int, workers: int, seed: int) -> DataLoader[InstanceSample]:
    """Batches of an epoch; an incomplete last one is left out when there is another."""
    return DataLoader(
        crops,
        batch_size=batch,
        sampler=EpochOrder(crops, seed),
        num_workers=workers,
        collate_fn=collate,
        drop_last=len(crops) > batch,
        pin_memory=torch.cuda.is_available(),
    )
