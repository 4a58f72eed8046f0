"""What a trained Mask R-CNN finds, as COCO results."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import torch
from pycocotools import mask as masks
from rich.progress import track
from torch import Tensor

from rpl_data.json_arrays import Json
from rpl_data.torch.instances import InstanceDataset
from rpl_data.types import DataError

from .weights import Segmenter

MASK_THRESHOLD = 0.5
"""A pixel belongs to the object when the network gives it a higher probability than this."""


@torch.no_grad()
def predict(segmenter: Segmenter, image: Tensor, image_id: int) -> list[Json]:
    """Find objects in an image (float32, 3 x height x width, 0 to 1) as COCO results, best first.

    Masks are visible pixels of the whole image; instances without a pixel are left out.
    """
    device = next(segmenter.model.parameters()).device
    found = segmenter.model([image.to(device)])[0]
    pixels = (found["masks"][:, 0] > MASK_THRESHOLD).cpu().numpy().astype(np.uint8)
    rows = zip(pixels, found["labels"].tolist(), found["scores"].tolist(), strict=True)
    return [_result(image_id, *row) for row in rows if row[0].any()]


def _result(image_id: int, pixels: np.ndarray, label: int, score: float) -> Json:
    rle = masks.encode(np.asfortranarray(pixels))
    return {
        "image_id": image_id,
        "category_id": label,
        "bbox": [float(side) for side in masks.toBbox(rle)],
        "score": score,
        "segmentation": {"size": list(rle["size"]), "counts": rle["counts"].decode("ascii")},
    }


def predict_split(
    segmenter: Segmenter, coco_json: Path, *, unreadable: Counter[str] | None = None
) -> tuple[list[Json], set[int]]:
    """Find objects in every image of a COCO file; results, and the ids of images that could not be read.

    A bar on a terminal shows how far it is.

    Args:
        segmenter: the trained network.
        coco_json: the file.
        unreadable: counts images that cannot be read, by message; without it the first is a DataError.

    Raises:
        DataError: the file has other objects than the network, or in another order: they go by numbers.
    """
    dataset = InstanceDataset(coco_json)
    if tuple(dataset.names) != segmenter.names:
        raise DataError(
            f"{coco_json} has the objects {', '.join(dataset.names[1:])}, the checkpoint "
            f"{', '.join(segmenter.names[1:])}; evaluate on the dataset it was trained on"
        )
    results: list[Json] = []
    left_out: set[int] = set()
    for row in track(range(len(dataset)), coco_json.name, transient=True, disable=not sys.stdout.isatty()):
        try:
            image, target = dataset[row]
        except DataError as error:
            if unreadable is None:
                raise
            unreadable[str(error)] += 1
            left_out.add(dataset.image_id(row))
            continue
        results += predict(segmenter, image, target["image_id"])
    return results, left_out
