"""Affine maps between image, crop and heatmap, and the pixels and positions they move.

A 2x3 matrix ``a_from_b`` takes pixel positions in b to a; pixel centres are whole numbers in all of them, so
an image n pixels wide covers -0.5 to n - 0.5 and resizing keeps edges, not centres, in place. Nothing here
mirrors: a mirrored object is another object. OpenCV is imported where it is used, so that programs print
their help quickly.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, UInt8

from rpl_data.torch.augmentation import Augmentation as Augmentation

Affine = Float64[np.ndarray, "2 3"]
Image = UInt8[np.ndarray, "height width 3"]
Pixels = UInt8[np.ndarray, "height width *channels"]
Resampled = UInt8[np.ndarray, "out_height out_width *channels"]


FULL_FROM_HALF: Affine = np.array([[2, 0, 0.5], [0, 2, 0.5]])
"""Map from an image of half the width and height to the full one; their edges coincide."""


# Affine maps --------------------------------------------------------------------------------------


def crop_from_square(
    centre_px: Float64[np.ndarray, "2"], side_px: float, *, input_px: int, rotation_rad: float = 0.0
) -> Affine:
    """Map from the image to a crop `input_px` wide that shows the square, rotated by `rotation_rad`."""
    zoom = input_px / side_px
    cos, sin = zoom * np.cos(rotation_rad), zoom * np.sin(rotation_rad)
    linear = np.array([[cos, -sin], [sin, cos]])
    middle = (input_px - 1) / 2  # between the edges -0.5 and input_px - 0.5
    return np.column_stack([linear, middle - linear @ centre_px])


def heatmap_from_crop(*, input_px: int, heatmap_px: int) -> Affine:
    """Map from a crop to its heatmap; their edges coincide."""
    zoom = heatmap_px / input_px
    return np.array([[zoom, 0, (zoom - 1) / 2], [0, zoom, (zoom - 1) / 2]])


def moved(a_from_b: Affine, positions_b: Float64[np.ndarray, "*batch 2"]) -> Float64[np.ndarray, "*batch 2"]:
    """Move positions from b to a; NaN stays NaN."""
    positions: Float64[np.ndarray, "*batch 2"] = positions_b @ a_from_b[:, :2].T + a_from_b[:, 2]
    return positions


def inverted(a_from_b: Affine) -> Affine:
    """Invert a map: returns ``b_from_a``."""
    linear = np.linalg.inv(a_from_b[:, :2])
    return np.column_stack([linear, -linear @ a_from_b[:, 2]])


def chained(a_from_b: Affine, b_from_c: Affine) -> Affine:
    """Chain two maps: returns ``a_from_c``."""
    return np.column_stack(
        [a_from_b[:, :2] @ b_from_c[:, :2], a_from_b[:, :2] @ b_from_c[:, 2] + a_from_b[:, 2]]
    )


def zoom_of(a_from_b: Affine) -> float:
    """Length of one pixel of b, in pixels of a."""
    return float(np.sqrt(abs(np.linalg.det(a_from_b[:, :2]))))


def warped(image: Pixels, out_from_image: Affine, *, size: tuple[int, int]) -> Resampled:
    """Warp the image to `size` = (width, height); black beyond the image's edge."""
    import cv2

    result: Resampled = cv2.warpAffine(image, out_from_image, size, flags=cv2.INTER_LINEAR)
    return result


def warped_smoothly(image: Pixels, out_from_image: Affine, *, size: tuple[int, int]) -> Resampled:
    """Warp like `warped`, but average pixels where the map shrinks, so that fine texture does not alias."""
    import cv2

    zoom = zoom_of(out_from_image)
    if zoom > 0.75:
        return warped(image, out_from_image, size=size)
    height, width = image.shape[:2]
    small_size = max(1, round(width * zoom)), max(1, round(height * zoom))
    small = cv2.resize(image, small_size, interpolation=cv2.INTER_AREA)
    across, down = width / small_size[0], height / small_size[1]
    image_from_small = np.array([[across, 0, (across - 1) / 2], [0, down, (down - 1) / 2]])
    return warped(small, chained(out_from_image, image_from_small), size=size)


# Augmentation -------------------------------------------------------------------------------------


def random_crop_from_square(
    centre_px: Float64[np.ndarray, "2"],
    side_px: float,
    augmentation: Augmentation,
    rng: np.random.Generator,
    *,
    input_px: int,
) -> Affine:
    """Map to a crop (as `crop_from_square`) of the square after a random shift, scaling and rotation."""
    shift, turn = (
        rng.uniform(-augmentation.shift, augmentation.shift, 2),
        np.deg2rad(augmentation.largest_turn_deg),
    )
    return crop_from_square(
        centre_px + shift * side_px,
        side_px * rng.uniform(1 - augmentation.scale, 1 + augmentation.scale),
        input_px=input_px,
        rotation_rad=rng.uniform(-turn, turn),
    )


def reach(augmentation: Augmentation | None) -> float:
    """Half side of the upright square around every possible crop, as a multiple of the box's side."""
    if augmentation is None:
        return 0.5
    turn = np.deg2rad(min(augmentation.largest_turn_deg, 45.0))
    return float((1 + augmentation.scale) * (np.cos(turn) + np.sin(turn)) / 2 + augmentation.shift)
