"""Colour images of an export: linked where they are stored as wanted already, converted elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from rpl_data.export.folder import link
from rpl_data.files import write_bytes
from rpl_data.formats.recordings.saved_images import encoded
from rpl_data.images import read_pixels
from rpl_data.types import DataError

ColorFormat = Literal["recorded", "png", "jpg"]
"""How colour images are stored: as they were recorded, or all in one format."""

SUFFIXES = {"png": (".png",), "jpg": (".jpg", ".jpeg")}


def write_color(source: Path, target: Path, color: ColorFormat) -> Path:
    """Write a colour image and return its path.

    Args:
        source: image of the exported COCO folder.
        target: path to write, without a suffix.
        color: the wanted format.

    Raises:
        DataError: the image is missing, or damaged and to be converted.
    """
    if color == "recorded":
        path = target.with_name(target.name + source.suffix)
        link(source, path)
        return path
    path = target.with_name(f"{target.name}.{color}")
    if source.suffix.lower() in SUFFIXES[color]:
        link(source, path)
        return path
    pixels = read_pixels(source)
    if pixels is None:
        raise DataError(f"{source} is missing or damaged; put it back and export again")
    write_bytes(path, encoded(pixels[..., ::-1], color))
    return path
