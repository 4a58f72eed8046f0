"""What a trained Mask R-CNN finds, as COCO results."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pycocotools import mask as masks
from rich.progress import track
from torch import Tensor

from rpl_data.torch.instances import InstanceDataset
from training.masks.weights import Segmenter

Json = dict[str, Any]
MASK_THRESHOLD = 0.5
"""A pixel belongs to the object when the network gives it more than this."""


@torch.no_grad()
def predict(segmenter: Segmenter, image: Tensor, image_id: int) -> list[Json]:
    """COCO results of an image (float32, 3 x height x width, 0 to 1), best first.

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


def predict_split(segmenter: Segmenter, coco_json: Path) -> list[Json]:
    """The results of every image of a COCO file; a bar on a terminal shows how far it is."""
    dataset = InstanceDataset(coco_json)
    results: list[Json] = []
    for row in track(range(len(dataset)), coco_json.name, transient=True, disable=not sys.stdout.isatty()):
        image, target = dataset[row]
        results += predict(segmenter, image, target["image_id"])
    return results
