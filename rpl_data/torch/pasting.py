"""Replace what is around an object in its crop, and hide part of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from rpl_data.torch.augmentation import Augmentation
from rpl_data.torch.cutouts import Pieces, backgrounds_of, occluders_of
from rpl_data.torch.keypoint_rows import KeypointRows
from rpl_data.torch.transforms import Image

MOST_HIDDEN = 0.5
"""Share of the object's visible pixels that an occluder may hide."""

TRIES = 5
"""Draws of an occluder's place before a crop goes without one."""

FEATHER_PX = 0.7
"""Standard deviation by which pasted edges are softened, as lenses soften real ones."""

Alpha = UInt8[np.ndarray, "height width"]


@dataclass(frozen=True)
class Pasting:
    """Where backgrounds and occluders come from; None where the augmentation asks for none."""

    backgrounds: Pieces | None = None
    occluders: Pieces | None = None


def pasting_of(
    augment: Augmentation | None,
    data: Mapping[str, Any],
    category_id: int,
    rows: KeypointRows,
    *,
    folder: Path,
    piece_px: int,
) -> Pasting | None:
    """Collect what an augmentation pastes into the crops of an object; None where it pastes nothing.

    Args:
        data: the COCO file, whose images are relative to `folder`.
        category_id: of the object.
        rows: its instances.
        piece_px: longer side of a cut-out object in memory, and half that of a background.

    Raises:
        DataError: there is nothing to paste.
    """
    if augment is None or not (augment.background or augment.occluders):
        return None
    return Pasting(
        backgrounds_of(rows, augment.backgrounds, 2 * piece_px) if augment.background else None,
        occluders_of(data, category_id, folder, piece_px) if augment.occluders else None,
    )


def pasted(
    crop: Image, mask: Alpha, pasting: Pasting, augmentation: Augmentation, rng: np.random.Generator
) -> tuple[Image, Bool[np.ndarray, "height width"] | None]:
    """Replace the background of some crops, and hide a part of the object in some.

    Args:
        crop: the crop of the object.
        mask: 255 where the object is seen in the crop.

    Returns:
        The changed crop, and where an occluder covers it; None without one.
    """
    if pasting.backgrounds is not None and rng.uniform() < augmentation.background and mask.any():
        crop = blended(background(pasting.backgrounds, len(crop), rng), crop, mask)
    if pasting.occluders is not None and rng.uniform() < augmentation.occluders and mask.any():
        for _ in range(TRIES):
            pixels, alpha = occluder(pasting.occluders, len(crop), rng)
            hidden = np.count_nonzero(mask[alpha > 127]) / np.count_nonzero(mask)
            if 0 < hidden <= MOST_HIDDEN:
                return blended(crop, pixels, alpha), alpha > 127
    return crop, None


def background(pieces: Pieces, size_px: int, rng: np.random.Generator) -> Image:
    """Draw a square of background: a piece in any turn, perhaps mirrored, and reflected at its own edges.

    It is about as sharp as the object: enlarging a small piece to the whole crop would tell them apart.
    """
    piece, _ = pieces.draw(rng)
    zoom, turn = rng.uniform(0.7, 1.4), rng.uniform(0, 2 * np.pi)
    linear = zoom * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    linear[:, 0] *= rng.choice([-1, 1])
    looked_at = rng.uniform(0, 1, 2) * [piece.shape[1] - 1, piece.shape[0] - 1]
    affine = np.column_stack([linear, (size_px - 1) / 2 - linear @ looked_at])
    square: Image = cv2.warpAffine(
        piece, affine, (size_px, size_px), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101
    )
    return square


def occluder(pieces: Pieces, size_px: int, rng: np.random.Generator) -> tuple[Image, Alpha]:
    """Draw another object onto an empty crop: any turn, a quarter to two thirds as long as the crop."""
    piece, alpha = pieces.draw(rng)
    height, width = piece.shape[:2]
    zoom = size_px * rng.uniform(0.25, 0.67) / max(height, width)
    turn = rng.uniform(0, 2 * np.pi)
    linear = zoom * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    centre = rng.uniform(0.1, 0.9, 2) * size_px
    affine = np.column_stack([linear, centre - linear @ np.array([(width - 1) / 2, (height - 1) / 2])])
    placed: tuple[Image, Alpha] = tuple(  # type: ignore[assignment]
        cv2.warpAffine(one, affine, (size_px, size_px), flags=cv2.INTER_LINEAR) for one in (piece, alpha)
    )
    return placed


def blended(below: Image, above: Image, alpha: Alpha) -> Image:
    """Lay an image over another one where alpha (0 to 255) says so, with soft edges."""
    soft = cv2.GaussianBlur(alpha, (0, 0), FEATHER_PX).astype(np.float32) / 255
    mixed: Image = cv2.blendLinear(above, below, soft, 1 - soft)
    return mixed


def hide(
    keypoints: Float64[np.ndarray, "k 3"],
    on_crop: Float64[np.ndarray, "k 2"],
    covered: Bool[np.ndarray, "height width"],
) -> Float64[np.ndarray, "k 3"]:
    """Mark the seen keypoints that an occluder covers as hidden (1)."""
    columns, rows = np.rint(np.nan_to_num(on_crop, nan=-1)).astype(int).T
    size = len(covered)
    inside = (columns >= 0) & (rows >= 0) & (columns < size) & (rows < size) & (keypoints[:, 2] == 2)
    result = keypoints.copy()
    result[inside, 2] = np.where(covered[rows[inside], columns[inside]], 1, 2)
    return result
