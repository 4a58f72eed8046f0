"""Depth images packed for reading them fast, or only a part of them.

The rows of an image are packed in bands of 16, each by itself, as steps from pixel to pixel in two planes of
bytes (`compiled_depth`), then zstd. All of an image takes a sixth of a PNG's time, a window of it a share of
that; the file is smaller than the PNG by a tenth. Files of earlier versions, one zstd frame of 16-bit
steps, are read too.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from rpl_data.files import write_bytes
from rpl_data.images import in_metres, read_depth_units
from rpl_data.types import (
    DepthImage,
    DepthUnits,
    Frame,
    ReadDepth,
    ReadDepthInto,
    Scene,
    Window,
)

LEVEL = 1
"""Compression level of zstd. Higher levels save a few per cent of the bytes but lose the time gained."""
BAND_ROWS = 16
"""Rows that are packed together: fewer are read faster by part, but take more bytes."""
MAGIC = 0x646C7072
"""The first four bytes, "rpld"; those of a zstd frame are others."""


def pack(units: DepthUnits) -> bytes:
    """Pack a 16-bit depth image: a mark, height and width, where each band ends, and the bands."""
    import zstandard

    from rpl_data.workspace.compiled_depth import planes_of

    planes, packer = planes_of(units), zstandard.ZstdCompressor(level=LEVEL, write_checksum=True)
    tops = range(0, units.shape[0], BAND_ROWS)
    bands = [packer.compress(planes[:, top : top + BAND_ROWS].tobytes()) for top in tops]
    header = np.array([MAGIC, *units.shape, *np.cumsum([len(band) for band in bands])], "<u4")
    return b"".join([header.tobytes(), *bands])


def unpack(packed: bytes, *, height: int, width: int) -> DepthUnits | None:
    """Unpack the image; None when the bytes are damaged or belong to an image of another size."""
    units: DepthUnits = np.empty((height, width), np.uint16)
    whole = (slice(0, height), slice(0, width))
    return units if unpack_into(packed, units, whole, unit=1.0) else None


def unpack_into(packed: bytes, image: DepthUnits | DepthImage, window: Window, *, unit: float) -> bool:
    """Unpack a window of an image, times `unit`, into the same window of another one of its size.

    Returns:
        False when the bytes are damaged or belong to an image of another size; what the window holds then is
        not to be used.
    """
    import zstandard

    from rpl_data.workspace.compiled_depth import fill_window

    height, width = image.shape
    if packed[:4] == zstandard.FRAME_HEADER:
        units = _unpacked_steps(packed, height=height, width=width)
        if units is not None:
            image[window] = units[window] * image.dtype.type(unit)
        return units is not None
    ends = _band_ends(packed, height=height, width=width)
    if ends is None:
        return False
    rows, columns = window
    first, end = rows.start // BAND_ROWS, -(-rows.stop // BAND_ROWS)
    bands = []
    for band, (low, high) in enumerate(pairwise(ends[first : end + 1]), start=first):
        band_rows = min(BAND_ROWS, height - band * BAND_ROWS)
        content = _decompressed(packed[low:high], size=2 * width * band_rows)
        if content is None:
            return False
        bands.append(content)
    limits = (rows.start, rows.stop), (columns.start, columns.stop)
    fill_window(np.frombuffer(b"".join(bands), np.uint8), BAND_ROWS, first * BAND_ROWS, *limits, unit, image)
    return True


def _band_ends(packed: bytes, *, height: int, width: int) -> list[int] | None:
    """Where each band begins, and the last one ends; None where that is not what the bytes hold."""
    count = -(-height // BAND_ROWS)
    start = 4 * (3 + count)
    if len(packed) < start:
        return None
    header = np.frombuffer(packed, "<u4", 3 + count).astype(np.int64)
    ends: list[int] = [start, *(header[3:] + start).tolist()]
    return ends if header[:3].tolist() == [MAGIC, height, width] and ends[-1] == len(packed) else None


def _unpacked_steps(packed: bytes, *, height: int, width: int) -> DepthUnits | None:
    """Unpack a file of an older version, 16-bit steps along all rows in one frame."""
    content = _decompressed(packed, size=2 * height * width)
    if content is None:
        return None
    steps = np.frombuffer(content, np.uint16).reshape(height, width)
    units: DepthUnits = np.cumsum(steps, axis=1, dtype=np.uint16)
    return units


def _decompressed(frame: bytes, *, size: int) -> bytes | None:
    """The content of a zstd frame; None where it is damaged or does not say that it has that size.

    The size is looked at first: memory is taken for what a frame says, and a damaged one may say anything.
    """
    import zstandard

    try:
        if zstandard.frame_content_size(frame) != size:
            return None
        return zstandard.ZstdDecompressor().decompress(frame)
    except zstandard.ZstdError:
        return None


def cached_reader(folder: Path, scene: Scene, *, keep: bool) -> ReadDepth:
    """Reads depth images in metres: from the folder where they are in it, else from the recording.

    Args:
        folder: packed images by the number of their frame.
        scene: whose frames are read.
        keep: put what is not in the folder into it, for the next reader.
    """

    def read(frame: Frame) -> DepthImage:
        path = _file(folder, frame)
        if scene.depth_camera is None and path.exists():
            depth_m: DepthImage = np.empty(scene.depth_size, np.float32)
            whole = (slice(0, depth_m.shape[0]), slice(0, depth_m.shape[1]))
            if unpack_into(path.read_bytes(), depth_m, whole, unit=_unit_m(scene)):
                return depth_m
        units = _kept_units(path, scene)
        if units is None:
            units = read_depth_units(scene, frame)
            if keep:
                write_bytes(path, pack(units))
        return in_metres(scene, units)

    return read


def cached_window_reader(folder: Path, scene: Scene) -> ReadDepthInto:
    """Reads windows of depth images in metres, from the folder or the recording; see `cached_reader`."""
    whole = cached_reader(folder, scene, keep=False)

    def read(frame: Frame, window: Window, image: DepthImage) -> None:
        path = _file(folder, frame)
        kept = scene.depth_camera is None and path.exists()
        if not kept or not unpack_into(path.read_bytes(), image, window, unit=_unit_m(scene)):
            image[window] = whole(frame)[window]

    return read


def _unit_m(scene: Scene) -> float:
    """The unit as `in_metres` takes it."""
    return float(np.float32(scene.metres_per_unit))


def _file(folder: Path, frame: Frame) -> Path:
    return folder / f"{frame.index:06d}.zst"


def _kept_units(path: Path, scene: Scene) -> DepthUnits | None:
    """Read a depth image from the cache; None when it is missing or damaged, since it can be rebuilt."""
    if not path.exists():
        return None
    height, width = scene.depth_size
    return unpack(path.read_bytes(), height=height, width=width)
