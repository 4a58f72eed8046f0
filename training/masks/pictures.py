"""Pictures with instances drawn on them: masks, boxes, names and scores."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import cv2
import numpy as np
import torch
from pycocotools import mask as masks
from torch import Tensor
from torchvision.utils import draw_segmentation_masks

from rpl_data.json_arrays import Json


def class_color(label: int, classes: int) -> tuple[int, int, int]:
    """Bright colours spread over the hues."""
    red, green, blue = colorsys.hsv_to_rgb((label - 1) / max(1, classes), 0.75, 1.0)
    return round(255 * red), round(255 * green), round(255 * blue)


def draw(pixels: np.ndarray, results: Sequence[Json], names: Sequence[str]) -> np.ndarray:
    """A new picture with masks tinted and outlined, boxes, names and scores; the best lie on top."""
    picture = pixels.copy()
    for entry in sorted(results, key=lambda entry: float(entry["score"])):
        label = entry["category_id"]
        color = class_color(label, len(names) - 1)
        inside = np.ascontiguousarray(masks.decode(entry["segmentation"]))
        picture[inside > 0] = (0.6 * picture[inside > 0] + 0.4 * np.array(color)).astype(np.uint8)
        outlines, _ = cv2.findContours(inside, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, outlines, -1, color, 1, cv2.LINE_AA)
        left, top, width, height = (round(side) for side in entry["bbox"])
        cv2.rectangle(picture, (left, top), (left + width - 1, top + height - 1), color, 1)
        write_words(picture, f"{names[label]} {entry['score']:.2f}", (left, max(12, top - 4)), color)
    return picture


def tinted(image: Tensor, found: Tensor, labels: Tensor, classes: int) -> Tensor:
    """An image with masks tinted, for TensorBoard; 3 x height x width, uint8.

    Args:
        image: 3 x height x width, 0 to 1.
        found: n x height x width, true inside.
        labels: n, of the masks.
        classes: number of labels, with the background.
    """
    picture = (255 * image.detach().float().cpu().clamp(0, 1)).round().to(torch.uint8)
    if not len(found):
        return picture
    colours = [class_color(int(label), classes - 1) for label in labels]
    drawn: Tensor = draw_segmentation_masks(picture, found.cpu(), alpha=0.4, colors=colours)
    return drawn


def write_words(
    picture: np.ndarray, words: str, corner: tuple[int, int], color: tuple[int, int, int]
) -> None:
    """Write on a picture, with dark edges so that it can be read on any ground."""
    for shade, thickness in (((15, 15, 15), 3), (color, 1)):
        cv2.putText(picture, words, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.45, shade, thickness, cv2.LINE_AA)
