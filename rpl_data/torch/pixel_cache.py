"""Cache of the decoded pixels around boxes, in memory or a file: decoding costs most of a sample's time."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64, UInt8

from rpl_data.torch.image_files import read_image
from rpl_data.torch.transforms import Image
from rpl_data.types import DataError


@dataclass(frozen=True)
class Rectangle:
    """A rectangle of whole pixels of an image; `right` and `bottom` are the first ones outside."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def size_bytes(self) -> int:
        """Bytes that its pixels take, three channels each."""
        return (self.right - self.left) * (self.bottom - self.top) * 3


def rectangle_around(
    square_box: Float64[np.ndarray, "3"], *, half: float, width: int, height: int
) -> Rectangle:
    """Return the pixels of the image that a crop within `half` sides of the box's centre can touch."""
    cx, cy, side = square_box
    reach = half * side + 2  # bilinear sampling looks a pixel beyond
    left, top = (int(np.clip(np.floor(c - reach), 0, n - 1)) for c, n in ((cx, width), (cy, height)))
    right, bottom = (int(np.clip(np.ceil(c + reach), 1, n)) for c, n in ((cx, width), (cy, height)))
    return Rectangle(left, top, max(right, left + 1), max(bottom, top + 1))


SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 (Linux's name for it)
"""What processes share in memory; a container may give it 64 MB, and writing beyond ends the process."""


class PixelCache:
    """Rectangles of images, decoded once and stored in one flat array that worker processes share.

    Forked workers share it as it is. For spawned ones, which get a pickled copy of everything else, it moves
    to shared memory, or is mapped from its file.
    """

    def __init__(
        self,
        files: Sequence[str],
        rectangles: Sequence[Rectangle],
        storage: bool | Path,
        *,
        sizes: Sequence[Sequence[int]],
        limit_mb: float | None = None,
    ) -> None:
        """Decode all rectangles, or reuse the file that an earlier run wrote.

        Args:
            files: path of the image of each rectangle.
            rectangles: the part of each image to keep.
            storage: a folder to keep the pixels in; True keeps them in memory.
            sizes: width and height that the labels state of each image.
            limit_mb: the first rectangles are kept, up to this many megabytes in all.

        Raises:
            DataError: the folder cannot be written, one of its images cannot be read or is of another size,
                or the limit is not above 0. In memory the other images are kept, and asking for the rectangle
                of the unreadable one raises its error.
        """
        if limit_mb is not None and limit_mb <= 0:
            raise DataError(f"cache_limit_mb is {limit_mb}; give more than 0, or no cache")
        if limit_mb is not None:
            ends = np.cumsum([rectangle.size_bytes for rectangle in rectangles])
            rectangles = rectangles[: int((ends <= limit_mb * 1e6).sum())]
            files = files[: len(rectangles)]
        self._rectangles, self._sizes = rectangles, sizes
        self._unreadable: dict[int, DataError] = {}
        self._path: Path | None = None
        self._shared: torch.Tensor | None = None
        self._offsets = np.cumsum([0, *(rectangle.size_bytes for rectangle in rectangles)])
        self._pixels: UInt8[np.ndarray, " n"]
        if isinstance(storage, Path):
            self._pixels = self._on_disk(files, storage)
        else:
            self._pixels = np.empty(self._offsets[-1], dtype=np.uint8)
            for row in range(len(rectangles)):
                try:
                    self._fill_row(row, files[row], self._pixels)
                except DataError as error:
                    self._unreadable[row] = error

    def __contains__(self, row: int) -> bool:
        """Whether the rectangle of a row (from 0) is kept."""
        return 0 <= row < len(self._rectangles)

    def __getstate__(self) -> dict[str, Any]:
        """What a spawned worker gets: the name of the file, or a handle of the shared memory."""
        state = self.__dict__ | {"_pixels": None}
        if self._path is None:
            state["_shared"] = self._in_shared_memory()
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Map what was shared."""
        self.__dict__.update(state)
        if self._path is not None:
            self._pixels = np.memmap(self._path, dtype=np.uint8, mode="r")
        elif self._shared is not None:
            self._pixels = self._shared.numpy()

    def _in_shared_memory(self) -> torch.Tensor:
        """Move the pixels to shared memory, once.

        Raises:
            DataError: there is too little of it.
        """
        if self._shared is None:
            free = shutil.disk_usage(SHARED_MEMORY).free if SHARED_MEMORY.is_dir() else np.inf
            if self._pixels.nbytes > free:
                raise DataError(
                    f"the cache of {self._pixels.nbytes / 1e6:.0f} MB does not fit into the shared memory "
                    f"({SHARED_MEMORY}, {free / 1e6:.0f} MB free), from which spawned workers read it; give "
                    "`cache` a folder, or lower `cache_limit_mb`"
                )
            self._shared = torch.from_numpy(self._pixels)
            self._shared.share_memory_()  # type: ignore[no-untyped-call]
            self._pixels = self._shared.numpy()
        return self._shared

    def __getitem__(self, row: int) -> tuple[Image, Rectangle]:
        """Return a rectangle and its pixels; DataError when its image could not be read."""
        if row in self._unreadable:
            raise self._unreadable[row]
        rectangle = self._rectangles[row]
        flat = self._pixels[self._offsets[row] : self._offsets[row + 1]]
        return flat.reshape(rectangle.bottom - rectangle.top, -1, 3), rectangle

    def _fill(self, files: Sequence[str], pixels: UInt8[np.ndarray, " n"]) -> None:
        for row, file in enumerate(files):
            self._fill_row(row, file, pixels)

    def _fill_row(self, row: int, file: str, pixels: UInt8[np.ndarray, " n"]) -> None:
        rectangle = self._rectangles[row]
        image = read_image(file, size=self._sizes[row])
        cut = image[rectangle.top : rectangle.bottom, rectangle.left : rectangle.right]
        pixels[self._offsets[row] : self._offsets[row + 1]] = cut.reshape(-1)

    def _on_disk(self, files: Sequence[str], folder: Path) -> UInt8[np.ndarray, " n"]:
        """Map the file of exactly these rectangles and images (by size and time); write it when missing."""
        path = folder / f"pixels-{_fingerprint(files, self._rectangles)}.u8"
        if not path.exists():
            try:
                folder.mkdir(parents=True, exist_ok=True)
                handle, temporary = tempfile.mkstemp(dir=folder, prefix=".pixels-")
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
        self._path = path
        return np.memmap(path, dtype=np.uint8, mode="r")


def _fingerprint(files: Sequence[str], rectangles: Sequence[Rectangle]) -> str:
    digest = hashlib.sha256()
    for file, rectangle in zip(files, rectangles, strict=True):
        try:
            status = os.stat(file)
        except OSError as error:
            raise DataError(
                f"cannot read the image {file}: {error.strerror}; export the dataset again"
            ) from error
        digest.update(repr((str(file), status.st_size, status.st_mtime_ns, rectangle)).encode())
    return digest.hexdigest()[:16]
