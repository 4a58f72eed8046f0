"""Depth images that come through the lens of the colour images, but have another size: those of phones."""

from __future__ import annotations

from pathlib import Path

from rpl_data.geometry import resized
from rpl_data.types import DataError, DepthCamera, Intrinsics

COLOR_LENS: tuple[float, ...] = ()
"""Stands for the camera of such depth images where a reader names the depth camera."""

MOST_STRETCHED = 0.02
"""Largest difference between the shapes of two images of one view: sizes are whole numbers of pixels."""


def stretched(one_px: tuple[int, int], other_px: tuple[int, int]) -> bool:
    """Whether images of these widths and heights cannot show the same view."""
    return abs(one_px[0] * other_px[1] / (one_px[1] * other_px[0]) - 1) > MOST_STRETCHED


def behind_color_lens(folder: Path, color: Intrinsics, width: int, height: int) -> DepthCamera | None:
    """The camera of depth images of this size; None where it is that of the colour images.

    Raises:
        DataError: the images have another shape, so that they cannot show the same view.
    """
    if (width, height) == (color.width, color.height):
        return None
    if stretched((width, height), (color.width, color.height)):
        raise DataError(
            f"{folder}: depth of {width} x {height} px and colour of {color.width} x {color.height} px do "
            "not show the same view; rotate or crop one of them, or register depth to colour when recording"
        )
    return DepthCamera(resized(color, width=width, height=height))


def size_notes(color: Intrinsics, depth: DepthCamera | None) -> list[str]:
    """Note that depth has pixels of its own."""
    if depth is None:
        return []
    own, among = depth.intrinsics, f"{color.width} x {color.height}"
    return [f"depth has {own.width} x {own.height} px, colour {among}: it is looked up at the colour pixels"]


def camera_numbers(intrinsics: Intrinsics) -> tuple[float, ...]:
    """The numbers of a camera, as `intrinsics_of` takes them."""
    lens = intrinsics
    return (lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion)
