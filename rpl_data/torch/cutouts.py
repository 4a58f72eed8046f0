"""Pieces of other pictures to paste into training crops: backgrounds, and objects cut out by their masks.

Only images of the same split are used, so nothing of a test scene enters. Pieces are decoded when first
drawn and then kept small, at most `MOST_PIECES` of them per process.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from rpl_data.torch.augmentation import PICTURES
from rpl_data.torch.image_files import read_image
from rpl_data.torch.keypoint_rows import KeypointRows
from rpl_data.torch.pixel_cache import Rectangle
from rpl_data.torch.targets import decoded_masks
from rpl_data.torch.transforms import Image
from rpl_data.types import DataError

MOST_PIECES = 256
"""Pieces per pool, spread evenly over the images: at most 50 MB for crops of 128 px."""

NARROWEST_PX = 48
"""A strip of background narrower than this shows nothing."""

MOSTLY_SEEN = 0.8
"""Visible share of an object that is whole enough to be cut out."""

SMALLEST_SHARE = 0.003
"""Share of the image that an object must fill to be cut out: 30 x 30 px of 640 x 480."""

Alpha = UInt8[np.ndarray, "height width"]


@dataclass(frozen=True)
class Piece:
    """A part of an image file; all of it without a rectangle, within a mask where there is one.

    `size` is what labels state, width and height, where it was cut by labels.
    """

    file: str
    rectangle: Rectangle | None = None
    mask: tuple[bytes, int, int] | None = None
    size: tuple[int, int] | None = None

    def read(self, longest_px: int) -> tuple[Image, Alpha]:
        """Decode the piece, shrunk to that size, with 255 where it is opaque."""
        image = read_image(self.file, size=self.size)
        alpha = np.full(image.shape[:2], 255, dtype=np.uint8)
        if self.mask is not None:
            counts, height, width = self.mask
            packed = {"size": [height, width], "counts": counts}
            alpha = decoded_masks([packed], (height, width))[0].numpy() * np.uint8(255)
        if self.rectangle is not None:
            left, top, right, bottom = vars(self.rectangle).values()
            image, alpha = image[top:bottom, left:right], alpha[top:bottom, left:right]
        zoom = longest_px / max(image.shape[:2])
        if zoom >= 1:
            return image.copy(), alpha.copy()
        size = max(1, round(image.shape[1] * zoom)), max(1, round(image.shape[0] * zoom))
        small: tuple[Image, Alpha] = tuple(  # type: ignore[assignment]
            cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in (image, alpha)
        )
        return small


class Pieces:
    """A pool of pieces, each decoded once per process."""

    def __init__(self, pieces: Sequence[Piece], longest_px: int) -> None:
        """Keep `MOST_PIECES` of them, spread evenly, shrunk to `longest_px` when they are decoded."""
        count = min(len(pieces), MOST_PIECES)
        self._pieces = [pieces[row * len(pieces) // count] for row in range(count)]
        self._longest_px = longest_px
        self._decoded: dict[int, tuple[Image, Alpha]] = {}

    def __len__(self) -> int:
        """Number of pieces."""
        return len(self._pieces)

    def __getstate__(self) -> dict[str, Any]:
        """Without the decoded pieces, which each worker decodes for itself."""
        return self.__dict__ | {"_decoded": {}}

    def draw(self, rng: np.random.Generator) -> tuple[Image, Alpha]:
        """Draw a piece at random."""
        row = int(rng.integers(len(self._pieces)))
        if row not in self._decoded:
            self._decoded[row] = self._pieces[row].read(self._longest_px)
        return self._decoded[row]


def backgrounds_of(rows: KeypointRows, folder: str | None, longest_px: int) -> Pieces:
    """Collect backgrounds: the pictures of a folder, or what the frames show beside the object.

    Raises:
        DataError: the folder has no pictures, or the object fills every frame.
    """
    if folder is not None:
        place = Path(folder).expanduser()
        files = sorted(path for path in place.rglob("*") if path.suffix.lower() in PICTURES)
        if not files:
            raise DataError(f"augment.backgrounds: {place} has no pictures ({', '.join(sorted(PICTURES))})")
        return Pieces([Piece(str(path)) for path in files], longest_px)
    beside = [
        Piece(str(file), widest, size=tuple(size.tolist()))
        for file, box, size in zip(rows.files, rows.square_boxes, rows.sizes, strict=True)
        if (widest := _widest_strip(box, *size.tolist())) is not None
    ]
    if not beside:
        raise DataError(
            "augment.background: no frame shows anything beside the object; name a folder of pictures by "
            "augment.backgrounds"
        )
    return Pieces(beside, longest_px)


def _widest_strip(square_box: Float64[np.ndarray, "3"], width: int, height: int) -> Rectangle | None:
    """The strip beside the square box whose shorter side is longest; None where all are too narrow."""
    cx, cy, side = square_box
    left, right = (int(np.clip(cx + sign * side / 2, 0, width)) for sign in (-1, 1))
    top, bottom = (int(np.clip(cy + sign * side / 2, 0, height)) for sign in (-1, 1))
    strips = [
        Rectangle(0, 0, left, height),
        Rectangle(right, 0, width, height),
        Rectangle(0, 0, width, top),
        Rectangle(0, bottom, width, height),
    ]
    widest = max(strips, key=_shorter_side)
    return widest if _shorter_side(widest) >= NARROWEST_PX else None


def _shorter_side(strip: Rectangle) -> int:
    return min(strip.right - strip.left, strip.bottom - strip.top)


def occluders_of(data: Mapping[str, Any], category_id: int, folder: Path, longest_px: int) -> Pieces:
    """Collect the other objects of a dataset, where they are seen nearly whole.

    Raises:
        DataError: the dataset has no other object.
    """
    images = {image["id"]: image for image in data["images"]}
    others = []
    for annotation in data["annotations"]:
        image = images[annotation["image_id"]]
        large = annotation["area"] >= SMALLEST_SHARE * image["width"] * image["height"]
        if annotation["category_id"] != category_id and large and annotation["visib_fract"] >= MOSTLY_SEEN:
            others.append(_cutout(annotation, image, folder))
    if not others:
        raise DataError("augment.occluders: the dataset shows no other object that could hide this one")
    return Pieces(others, longest_px)


def _cutout(annotation: Mapping[str, Any], image: Mapping[str, Any], folder: Path) -> Piece:
    x, y, width, height = (int(side) for side in annotation["bbox"])
    mask = (annotation["segmentation"]["counts"].encode(), image["height"], image["width"])
    size = image["width"], image["height"]
    return Piece(str(folder / image["file_name"]), Rectangle(x, y, x + width, y + height), mask, size)
