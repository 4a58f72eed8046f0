"""Depth images packed for reading them fast, or only a part of them.

The rows of an image are packed in bands of 16, each by itself, as steps from pixel to pixel in two planes of
bytes (`compiled_depth`), then zstd. All of an image takes a sixth of a PNG's time, a window of it a share of
that; the file is smaller than the PNG by a tenth. Files of earlier versions, one zstd frame of 16-bit
steps, are read too.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rpl_data.files import write_bytes
from rpl_data.images import in_metres, read_depth_units
from rpl_data.types import (
    DepthImage,
    DepthUnits,
    Frame,
    ReadDepth,
    ReadDepthWithin,
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


def unpack(packed: bytes, *, height: int, width: int, window: Window | None = None) -> DepthUnits | None:
    """Unpack the image; None when the bytes are damaged or belong to an image of another size.

    Args:
        window: the rows and columns that are wanted; the other pixels may then be 0.
    """
    import zstandard

    from rpl_data.workspace.compiled_depth import fill_rows

    if packed[:4] == zstandard.FRAME_HEADER:
        return _unpacked_steps(packed, height=height, width=width)
    count = -(-height // BAND_ROWS)
    start = 4 * (3 + count)
    if len(packed) < start:
        return None
    header = np.frombuffer(packed, "<u4", 3 + count)
    ends = [start, *(int(end) + start for end in header[3:])]
    if header[:3].tolist() != [MAGIC, height, width] or ends[-1] != len(packed):
        return None
    rows, columns = window or (slice(0, height), slice(0, width))
    units: DepthUnits = np.zeros((height, width), np.uint16)
    unpacker = zstandard.ZstdDecompressor()
    for band in range(rows.start // BAND_ROWS, -(-rows.stop // BAND_ROWS)):
        part = units[band * BAND_ROWS : (band + 1) * BAND_ROWS]
        try:
            planes = np.frombuffer(unpacker.decompress(packed[ends[band] : ends[band + 1]]), np.uint8)
        except zstandard.ZstdError:
            return None
        if planes.size != 2 * part.size:
            return None
        fill_rows(part, planes.reshape(2, *part.shape), columns=columns.stop)
    return units


def _unpacked_steps(packed: bytes, *, height: int, width: int) -> DepthUnits | None:
    """Unpack a file of an older version, 16-bit steps along all rows in one frame."""
    import zstandard

    try:
        steps = np.frombuffer(zstandard.ZstdDecompressor().decompress(packed), np.uint16)
    except zstandard.ZstdError:
        return None
    if steps.size != height * width:
        return None
    units: DepthUnits = np.cumsum(steps.reshape(height, width), axis=1, dtype=np.uint16)
    return units


def cached_reader(folder: Path, scene: Scene, *, keep: bool) -> ReadDepth:
    """Reads depth images in metres: from the folder where they are in it, else from the recording.

    Args:
        folder: packed images by the number of their frame.
        scene: whose frames are read.
        keep: put what is not in the folder into it, for the next reader.
    """

    def read(frame: Frame) -> DepthImage:
        path = _file(folder, frame)
        units = _kept_units(path, scene, None)
        if units is None:
            units = read_depth_units(scene, frame)
            if keep:
                write_bytes(path, pack(units))
        return in_metres(scene, units)

    return read


def cached_window_reader(folder: Path, scene: Scene) -> ReadDepthWithin:
    """Reads windows of depth images in metres, from the folder or the recording; see `cached_reader`."""

    def read(frame: Frame, window: Window) -> DepthImage:
        if scene.depth_camera is not None:  # its pixels are others than the window's
            return cached_reader(folder, scene, keep=False)(frame)
        units = _kept_units(_file(folder, frame), scene, window)
        if units is None:
            units = read_depth_units(scene, frame)
        depth_m: DepthImage = np.zeros(units.shape, np.float32)
        np.multiply(units[window], np.float32(scene.metres_per_unit), out=depth_m[window], dtype=np.float32)
        return depth_m

    return read


def _file(folder: Path, frame: Frame) -> Path:
    return folder / f"{frame.index:06d}.zst"


def _kept_units(path: Path, scene: Scene, window: Window | None) -> DepthUnits | None:
    """Read a depth image from the cache; None when it is missing or damaged, since it can be rebuilt."""
    if not path.exists():
        return None
    height, width = scene.depth_size
    return unpack(path.read_bytes(), height=height, width=width, window=window)
