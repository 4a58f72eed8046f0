"""How training images are changed at random; the options only, so that programs print their help quickly."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from rpl_data.types import DataError

PICTURES = {".jpg", ".jpeg", ".png", ".bmp", ".webp"}
"""Endings of the pictures that are looked for in a folder of backgrounds."""


@dataclass(frozen=True)
class Augmentation:
    """How far a training crop may stray from the label's box: largest deviations, drawn uniformly.

    Attributes:
        scale: the box's side is multiplied by 1 - scale to 1 + scale (the paper's trainer: 0.25).
        shift: the box moves by this share of its side at most, along each axis.
        rotation_deg: rotation in the image plane about the crop's centre. It is part of `crop_from_image` and
            never alters the intrinsics. `auto`: 180 where the object lies on different sides in different
            scenes (its axis that points up differs by more than 45 deg), else 30.
        gain: each colour channel is multiplied by 1 - gain to 1 + gain (the paper's trainer: 0.2).
        offset: added to all channels, as a share of white.
        light: the brightness rises by up to this share from one side of the crop to the other, in any
            direction, and brightnesses are bent by an exponent of 1 / (1 + light) to 1 + light.
        blur_px: largest standard deviation of a Gaussian blur, pixels of the crop.
        noise: largest standard deviation of noise per pixel and channel, as a share of white.
        background: share of crops in which everything but the object is replaced, by its visible mask.
        backgrounds: folder of pictures to replace it with; the recording's other frames, beside the object,
            when left out.
        occluders: share of crops in which another object of the dataset, cut out by its mask, hides up to
            half of this one.
    """

    scale: float = 0.25
    shift: float = 0.1
    rotation_deg: float | Literal["auto"] = 30.0
    gain: float = 0.2
    offset: float = 0.1
    light: float = 0.0
    blur_px: float = 0.0
    noise: float = 0.0
    background: float = 0.0
    backgrounds: str | None = None
    occluders: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what cannot be drawn."""
        for name, value in vars(self).items():
            if isinstance(value, int | float) and not 0 <= value < math.inf:
                raise DataError(f"augment.{name} is {value}; it is a largest deviation: give 0 or more")
        if self.scale >= 1:
            raise DataError(f"augment.scale is {self.scale}; below 1, or a box could vanish")
        for name in ("background", "occluders"):
            if getattr(self, name) > 1:
                raise DataError(f"augment.{name} is {getattr(self, name)}; it is a share of crops: 0 to 1")
        if self.backgrounds is not None and not self.background:
            raise DataError("augment.backgrounds names a folder that nothing uses; set augment.background")

    @property
    def largest_turn_deg(self) -> float:
        """`rotation_deg` as a number.

        Raises:
            DataError: it is `auto`, which only `KeypointDataset` knows how to decide.
        """
        if self.rotation_deg == "auto":
            raise DataError("augment.rotation_deg is auto, which is for one object's crops; give degrees")
        return float(self.rotation_deg)


def refuse_for_one_object(augmentation: Augmentation) -> None:
    """Refuse options that one object's crops alone can have, where images show several objects.

    Raises:
        DataError: `background` or `occluders` is set, or `rotation_deg` is `auto`.
    """
    _ = augmentation.largest_turn_deg  # which refuses `auto`
    if augmentation.background or augmentation.occluders:
        raise DataError(
            "augment.background and augment.occluders are for the crops of KeypointDataset: give 0"
        )
