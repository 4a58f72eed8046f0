"""Read image files and turn their pixels into tensors."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from rpl_data.images import read_pixels
from rpl_data.torch.transforms import Image
from rpl_data.types import DataError


def read_image(path: str, *, halved: bool = False, size: Sequence[int] | None = None) -> Image:
    """Read the image as RGB; DataError when it is missing, damaged or not as large as its labels say.

    Args:
        halved: halve width and height, each pixel being the mean of four (an odd last row or column may be
            lost). A JPEG is then decoded at half resolution, in less than half the time.
        size: width and height that the labels state, of the whole image; None asks for none.
    """
    image = read_pixels(path, reduce=2 if halved else 1)
    if image is None:
        raise DataError(f"cannot read the image {path}: it is missing or damaged; export the dataset again")
    if size is not None and not _as_stated(image, size, reduced=2 if halved else 1):
        found = f"{image.shape[1]} x {image.shape[0]} px{' at half its size' if halved else ''}"
        raise DataError(
            f"the image {path} is {found}, its labels are for {size[0]} x {size[1]} px; export the dataset "
            "again: keypoints, boxes and masks would lie elsewhere"
        )
    return image


def _as_stated(image: Image, size: Sequence[int], *, reduced: int) -> bool:
    """Whether an image has a size, reduced; a last row or column that is not whole may be there or not."""
    found = image.shape[1], image.shape[0]
    return all(full // reduced <= side <= -(-full // reduced) for side, full in zip(found, size, strict=True))


def to_unit_range(image: Image) -> Float32[Tensor, "3 height width"]:
    """Convert uint8 height x width x 3 to float32 3 x height x width, 0 to 1."""
    planes = np.empty((3, *image.shape[:2]), dtype=np.uint8)
    cv2.split(image, list(planes))  # three times as fast as a permuted copy
    return torch.from_numpy(planes).to(torch.float32).div_(255)
