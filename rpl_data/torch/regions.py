"""Decoded pixels around boxes, kept in memory or in a file, since decoding costs most of a sample."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, UInt8

from rpl_data.torch.images import read_image
from rpl_data.torch.transforms import Image
from rpl_data.types import DataError


@dataclass(frozen=True)
class Region:
    """A rectangle of whole pixels of an image; right and bottom are the first ones outside."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def size_bytes(self) -> int:
        """Of its pixels, three channels."""
        return (self.right - self.left) * (self.bottom - self.top) * 3


def region_around(square_box: Float64[np.ndarray, "3"], *, half: float, width: int, height: int) -> Region:
    """The pixels of the image that a crop within `half` sides of the box's centre can touch."""
    cx, cy, side = square_box
    reach = half * side + 2  # bilinear sampling looks a pixel beyond
    left, top = (int(np.clip(np.floor(c - reach), 0, n - 1)) for c, n in ((cx, width), (cy, height)))
    right, bottom = (int(np.clip(np.ceil(c + reach), 1, n)) for c, n in ((cx, width), (cy, height)))
    return Region(left, top, max(right, left + 1), max(bottom, top + 1))


class RegionCache:
    """Regions of images, decoded once, one behind the other in a flat array that workers share."""

    def __init__(self, files: Sequence[str], regions: Sequence[Region], place: bool | Path) -> None:
        """Decode all regions, or take them over from an earlier run.

        Args:
            files: image of each region.
            regions: what is kept of it.
            place: True for memory, or a folder.

        Raises:
            DataError: the folder cannot be written, or an image cannot be read that is to be kept in it. In
                memory the others are kept, and the region of a broken image is refused when asked for.
        """
        self._regions = regions
        self._unreadable: dict[int, DataError] = {}
        self._offsets = np.concatenate([[0], np.cumsum([region.size_bytes for region in regions])])
        self._pixels: UInt8[np.ndarray, " n"]
        if isinstance(place, Path):
            self._pixels = self._on_disk(files, place)
        else:
            self._pixels = np.empty(self._offsets[-1], dtype=np.uint8)
            for row in range(len(regions)):
                try:
                    self._fill_row(row, files[row], self._pixels)
                except DataError as error:
                    self._unreadable[row] = error

    def __getitem__(self, row: int) -> tuple[Image, Region]:
        """The pixels of a region, and where in the image they are; DataError when it could not be read."""
        if row in self._unreadable:
            raise self._unreadable[row]
        region = self._regions[row]
        flat = self._pixels[self._offsets[row] : self._offsets[row + 1]]
        return flat.reshape(region.bottom - region.top, -1, 3), region

    def _fill(self, files: Sequence[str], pixels: UInt8[np.ndarray, " n"]) -> None:
        for row, file in enumerate(files):
            self._fill_row(row, file, pixels)

    def _fill_row(self, row: int, file: str, pixels: UInt8[np.ndarray, " n"]) -> None:
        region = self._regions[row]
        cut = read_image(file)[region.top : region.bottom, region.left : region.right]
        pixels[self._offsets[row] : self._offsets[row + 1]] = cut.reshape(-1)

    def _on_disk(self, files: Sequence[str], folder: Path) -> UInt8[np.ndarray, " n"]:
        """The file of exactly these images (by size and time) and regions; written when it is not there."""
        path = folder / f"regions-{_fingerprint(files, self._regions)}.u8"
        if not path.exists():
            try:
                folder.mkdir(parents=True, exist_ok=True)
                handle, temporary = tempfile.mkstemp(dir=folder, prefix=".regions-")
                os.close(handle)
                try:
                    pixels = np.memmap(temporary, dtype=np.uint8, mode="w+", shape=(int(self._offsets[-1]),))
                    self._fill(files, pixels)
                    pixels.flush()
                    os.replace(temporary, path)
                finally:
                    Path(temporary).unlink(missing_ok=True)
            except OSError as error:
                raise DataError(
                    f"cannot write the cache {path}: {error.strerror}; choose another folder"
                ) from error
        return np.memmap(path, dtype=np.uint8, mode="r")


def _fingerprint(files: Sequence[str], regions: Sequence[Region]) -> str:
    digest = hashlib.sha256()
    for file, region in zip(files, regions, strict=True):
        try:
            status = os.stat(file)
        except OSError as error:
            raise DataError(
                f"cannot read the image {file}: {error.strerror}; export the dataset again"
            ) from error
        digest.update(repr((str(file), status.st_size, status.st_mtime_ns, region)).encode())
    return digest.hexdigest()[:16]
